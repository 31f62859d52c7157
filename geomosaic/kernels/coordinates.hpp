// Image coordinates of the sub-pixels of output rows, interpolated between the nodes of a lattice.
//
// A row is placed, then sampled, while its coordinates are still in the processor's nearest cache; loops are split so
// that those over arithmetic alone become vector instructions.

#pragma once

#include "array.hpp"

constexpr int32_t FAR = 2147483647;

// What `sensor.lattice.Lattice` holds: `nodes` (ny, nx, 8) are cubic coefficients in height, `places` (ny, nx, 2) node
// positions in the height patch (0 = centre of the first height), `heights` the patch.
struct Geometry {
    View<double, 3> nodes, places;
    View<float, 2> heights;
    double z_middle, z_inverse;
    bool flat;
    int64_t step;
};

// Arguments of kernels that take a geometry.
#define GEOMETRY                                                                                               \
    const Array *nodes, const Array *places, const Array *heights, double z_middle, double z_inverse, int64_t flat, \
        int64_t step
#define GEOMETRY_OF Geometry{nodes, places, heights, z_middle, z_inverse, flat != 0, step}

// Columns and rows of pixels that fall in the image: first column, first row, last column, last row.
struct Span {
    int32_t first_col = FAR, first_row = FAR, last_col = -1, last_row = -1;

    // In whole numbers, so that the loop can be vectorised.
    void widen(const double *cols, const double *rows, int64_t number, double width, double height) {
        int32_t least_col = first_col, least_row = first_row, most_col = last_col, most_row = last_row;
        for (int64_t c = 0; c < number; c++) {
            const double x = cols[c], y = rows[c];
            const bool seen = (x >= 0.0) & (y >= 0.0) & (x < width) & (y < height);
            const int32_t col = static_cast<int32_t>(seen ? x : 0.0), row = static_cast<int32_t>(seen ? y : 0.0);
            least_col = smaller(least_col, seen ? col : FAR);
            least_row = smaller(least_row, seen ? row : FAR);
            most_col = larger(most_col, seen ? col : -1);
            most_row = larger(most_row, seen ? row : -1);
        }
        first_col = least_col, first_row = least_row, last_col = most_col, last_row = most_row;
    }
};

// Bilinear height at a place in nodes; a tap of no weight may be unknown, and NaN stands beyond half a node.
inline double height_at(const View<float, 2> &heights, double x, double y) {
    const int64_t last_col = heights.shape[1] - 1, last_row = heights.shape[0] - 1;
    if (!(x >= -0.5 && y >= -0.5 && x <= last_col + 0.5 && y <= last_row + 0.5)) return NAN;
    x = larger(x, 0.0), y = larger(y, 0.0);
    const int64_t x0 = smaller(static_cast<int64_t>(x), last_col), y0 = smaller(static_cast<int64_t>(y), last_row);
    const double fx = x - x0, fy = y - y0;
    const int64_t x1 = smaller(x0 + 1, last_col), y1 = smaller(y0 + 1, last_row);
    double first = heights(y0, x0), second = heights(y0, x1);
    if (fy > 0.0) {
        first += (heights(y1, x0) - first) * fy;
        second += (heights(y1, x1) - second) * fy;
    }
    return fx > 0.0 ? first + (second - first) * fx : first;
}

// Heights at places along a row of them. Neighbours are brought together first, and the rest is done for many places at
// once: instructions that look up values for several lanes take twice as long as two loads in one.
inline void heights_along(
    const double *__restrict known, const double *__restrict across, double first, double change, int64_t count,
    int32_t *__restrict post, Pair<double> *__restrict pairs, double *__restrict z
) {
    for (int64_t c = 0; c < count; c++) post[c] = static_cast<int32_t>(first + change * across[c]);
    for (int64_t c = 0; c < count; c++) memcpy(&pairs[c], &known[post[c]], sizeof *pairs);
    for (int64_t c = 0; c < count; c++) {
        const double part = first + change * across[c] - post[c], before = pairs[c].first;
        const double between = before + (pairs[c].second - before) * part;
        z[c] = part > 0.0 ? between : before;
    }
}

// Rows of sub-pixels placed one by one.
class Rows {
    const Geometry &geometry;
    int64_t n, width;
    Buffer<double> across, line, z;  // place of each sub-pixel between nodes; a row of heights; height of each
    Buffer<int32_t> post;            // known height before each sub-pixel, and that with the next one
    Buffer<Pair<double>> pairs;

public:
    Rows(const Geometry &geometry, int64_t n, int64_t width)
        : geometry(geometry), n(n), width(width), across(width), line(geometry.heights.shape[1]), z(width), post(width),
          pairs(width) {
        const int64_t step = geometry.step;
        for (int64_t c = 0; c < width; c++) across[c] = (c + 0.5) / n / step - c / (step * n);
    }

    // Place a row `v` steps down; what lies in cells that are not wanted becomes NaN.
    void place(double v, const uint8_t *wanted, double *cols, double *rows) const {
        const auto &[nodes, places, heights, z_middle, z_inverse, flat, step] = geometry;
        const int64_t wide = step * n, j = static_cast<int64_t>(v);
        const double fv = v - j;
        for (int64_t i = 0; i < nodes.shape[1] - 1; i++) {
            const int64_t start = i * wide, stop = smaller(start + wide, width);
            if (start >= stop) break;
            if (!wanted[i * step / CELL]) {
                for (int64_t c = start; c < stop; c++) cols[c] = rows[c] = NAN;
                continue;
            }
            double left[8], delta[8];
            for (int m = 0; m < 8; m++) {
                left[m] = nodes(j, i, m) + (nodes(j + 1, i, m) - nodes(j, i, m)) * fv;
                delta[m] = nodes(j, i + 1, m) + (nodes(j + 1, i + 1, m) - nodes(j, i + 1, m)) * fv - left[m];
            }
            if (flat) {
                for (int64_t c = start; c < stop; c++) {
                    cols[c] = left[0] + delta[0] * across[c];
                    rows[c] = left[4] + delta[4] * across[c];
                }
                continue;
            }
            double first[2], change[2];
            for (int m = 0; m < 2; m++) {
                first[m] = places(j, i, m) + (places(j + 1, i, m) - places(j, i, m)) * fv;
                change[m] = places(j, i + 1, m) + (places(j + 1, i + 1, m) - places(j, i + 1, m)) * fv - first[m];
            }
            find_heights(first[0], change[0], first[1], change[1], start, stop);
            for (int64_t c = start; c < stop; c++) {
                const double u = across[c], t = (z[c] - z_middle) * z_inverse;
                double place[2];
                for (int m = 0; m < 2; m++) {
                    const double *k = left + 4 * m, *d = delta + 4 * m;
                    place[m] = (((k[3] + d[3] * u) * t + (k[2] + d[2] * u)) * t + (k[1] + d[1] * u)) * t + (k[0] + d[0] * u);
                }
                cols[c] = place[0], rows[c] = place[1];
            }
        }
    }

private:
    // Heights of sub-pixels between two nodes.
    void find_heights(double xa, double xd, double ya, double yd, int64_t start, int64_t stop) const {
        const View<float, 2> &heights = geometry.heights;
        const double xb = xa + xd * across[stop - 1], last = heights.shape[1] - 1;
        // None of these holds of a place that is no number.
        const bool along = yd == 0.0 && ya >= 0.0 && ya <= heights.shape[0] - 0.5;
        if (!(along && xa >= 0.0 && xb >= 0.0 && xa < last && xb < last)) {
            for (int64_t c = start; c < stop; c++) z[c] = height_at(heights, xa + xd * across[c], ya + yd * across[c]);
            return;
        }
        // Along a row of heights: down once per height, then across once per sub-pixel.
        const double least = smaller(xa, xb), most = larger(xa, xb);
        const int64_t y0 = smaller(static_cast<int64_t>(ya), heights.shape[0] - 1);
        const int64_t y1 = smaller(y0 + 1, heights.shape[0] - 1);
        const double fy = ya - y0;
        for (int64_t x = static_cast<int64_t>(least); x < static_cast<int64_t>(most) + 2; x++) {
            const double top = heights(y0, x);
            line[x] = fy > 0.0 ? top + (heights(y1, x) - top) * fy : top;
        }
        heights_along(line, across + start, xa, xd, stop - start, post, pairs, z + start);
    }
};
