"""Map sheets: a layout as values, grids, contours, symbols and labels as pure functions, drawing in `draw/`.

Lengths on paper are millimetres from the lower left corner of the page, x right, y up; text sizes are points.
"""
