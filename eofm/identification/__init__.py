"""Stiffness from images, and its error bars."""
