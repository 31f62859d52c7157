// Image coordinates of output pixels: of whole rows, and of single pixels.

#include "coordinates.hpp"

static void write(const Span &found, const Array *span) {
    const View<int64_t, 1> out(span);
    out(0) = found.first_col, out(1) = found.first_row, out(2) = found.last_col, out(3) = found.last_row;
}

KERNEL int64_t coordinates(
    GEOMETRY, int64_t first_row, int64_t n, int64_t width, int64_t height, const Array *need, const Array *cols,
    const Array *rows, const Array *span
) {
    if (!without_gaps(need, cols, rows)) return NO_FORM;
    const Geometry geometry = GEOMETRY_OF;
    const View<double, 2> x(cols), y(rows);
    const View<uint8_t, 2> wanted(need);
    const Rows placed(geometry, n, x.shape[1]);
    Span found;
    for (int64_t k = 0; k < x.shape[0]; k++) {
        placed.place((first_row + (k + 0.5) / n) / step, wanted.row((first_row + k / n) / CELL), x.row(k), y.row(k));
        found.widen(x.row(k), y.row(k), x.shape[1], width, height);
    }
    write(found, span);
    return 0;
}

KERNEL int64_t coordinates_of_pixels(
    GEOMETRY, int64_t width, int64_t height, const Array *down, const Array *along, const Array *cols,
    const Array *rows, const Array *span
) {
    const Geometry geometry = GEOMETRY_OF;
    const View<int64_t, 1> at_row(down), at_col(along);
    const View<double, 1> x(cols), y(rows);
    const View<double, 3> &node = geometry.nodes, &place = geometry.places;
    for (int64_t k = 0; k < x.shape[0]; k++) {
        const double v = (at_row(k) + 0.5) / step;
        const int64_t j = static_cast<int64_t>(v), i = at_col(k) / step;
        // As in `Rows`: the place is a difference between cells, not a quotient within one.
        const double fv = v - j, u = (at_col(k) + 0.5) / step - i;
        const auto between = [&](const View<double, 3> &of, int m, double &left, double &delta) {
            left = of(j, i, m) + (of(j + 1, i, m) - of(j, i, m)) * fv;
            delta = of(j, i + 1, m) + (of(j + 1, i + 1, m) - of(j, i + 1, m)) * fv - left;
        };
        double left[8], delta[8];
        for (int m = 0; m < 8; m++) between(node, m, left[m], delta[m]);
        double found[2];
        double t = 0.0;
        if (!geometry.flat) {
            double first[2], change[2];
            for (int m = 0; m < 2; m++) between(place, m, first[m], change[m]);
            t = (height_at(geometry.heights, first[0] + change[0] * u, first[1] + change[1] * u) - z_middle) * z_inverse;
        }
        for (int m = 0; m < 2; m++) {
            const double *c = left + 4 * m, *d = delta + 4 * m;
            found[m] = geometry.flat
                           ? c[0] + d[0] * u
                           : (((c[3] + d[3] * u) * t + (c[2] + d[2] * u)) * t + (c[1] + d[1] * u)) * t + (c[0] + d[0] * u);
        }
        x(k) = found[0], y(k) = found[1];
    }
    Span seen;
    seen.widen(x.data, y.data, x.shape[0], width, height);
    write(seen, span);
    return 0;
}

KERNEL int64_t list_pixels(const Array *only, const Array *need, const Array *down, const Array *along) {
    const View<uint8_t, 2> pixels(only), cells(need);
    const View<int64_t, 1> rows(down), cols(along);
    int64_t number = 0;
    for (int64_t row = 0; row < pixels.shape[0]; row++)
        for (int64_t cell = 0; cell < cells.shape[1]; cell++) {
            if (!cells(row / CELL, cell)) continue;
            for (int64_t col = CELL * cell; col < smaller(CELL * cell + CELL, pixels.shape[1]); col++)
                if (pixels(row, col)) rows(number) = row, cols(number) = col, number++;
        }
    return number;
}
