"""Who shows what: shares laid by rule, by cost or by hand, and how well their borders meet."""
