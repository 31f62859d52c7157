"""One image on its control points: fits, model selection, leave-one-out errors, blunders."""
