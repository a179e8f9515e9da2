"""From formulas to functions in C or Python."""
