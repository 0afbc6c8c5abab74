"""Images as functions: splines, averages, grey scales, and the bubbles in them."""
