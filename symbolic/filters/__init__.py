"""One filter a file: its class `Spec` is the table of a spec file and builds the expressions."""
