"""One way to keep the velocity limits a file: its class `Spec` is the table `[velocity_limits]` of a spec file."""
