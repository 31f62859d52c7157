"""Enhancement for print: pure functions of arrays."""
