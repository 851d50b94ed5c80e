"""Decision trees: fitted by scikit-learn, kept and evaluated as plain arrays."""
