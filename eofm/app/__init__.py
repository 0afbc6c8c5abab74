"""The command, and the configuration of the workflow."""
