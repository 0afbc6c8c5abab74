"""Everything for one pair or sequence: what is known, results, quality, figures, files."""
