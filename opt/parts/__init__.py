"""What parts are made of: formulas in features, read for the solvers and checked."""
