"""One way a file for a one-sided task to begin and end to act: its class `Spec` is the table `activation` of a task."""
