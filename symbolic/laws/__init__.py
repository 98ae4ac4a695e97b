"""One law a file: its function `combine` turns tasks in priority order into a joint velocity."""
