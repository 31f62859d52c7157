"""Map sheets: a layout as values, grids, symbols and labels as pure functions, drawing in `drawing/`.

Lengths on paper are millimetres from the lower left corner of the page, x right, y up; text sizes are points.
"""
