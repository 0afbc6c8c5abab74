"""Samples whose truth is known: phantoms and a virtual OCT."""
