"""The paper's functional term by term, its solver, coarse to fine, and the estimate."""
