"""Motion tasks in files, and reports of their motions."""
