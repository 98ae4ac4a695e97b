"""One planner a file: its class `Spec` is the table `[planner]` of a spec file."""
