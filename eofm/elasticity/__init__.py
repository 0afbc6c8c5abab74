"""The forward model of a pressed sample, and its derivative."""
