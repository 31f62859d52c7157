// Lines of sight followed over heights, and heights over vertical walls; `resample/occlusion.py` says what is computed.
//
// Most places see the sensor, and most of what a surface model holds is in nobody's way. So groups of places are judged
// together first: where nothing along all of their lines of sight is high enough, none of them is followed.

#include "array.hpp"

namespace {

constexpr double NEVER = __builtin_inf();
// Nodes nearer than which a cell counts only where it is a wall.
constexpr double NEAR = 4.0;
// Nodes: a cell of which a line of sight passes less is not in its way; places are at nodes but for rounding.
constexpr double TOUCH = 1e-6;
// Pixels along a group's side; a divisor of those between nodes.
constexpr int64_t GROUP = 16;
// Parts of their lines of sight that are looked at one by one.
constexpr int64_t PARTS = 6;

using Heights = View<float, 2>;

// What `Field` holds, with the metres between nodes that are a wall to every line of sight.
struct Field {
    View<double, 3> nodes;
    double z_middle, z_inverse, wall;
    int64_t step;

    // Value below node (i, j), `v` of the way to the next, 0 to 1.
    double down(int64_t i, int64_t j, double v, int k) const {
        return nodes(i, j, k) + (nodes(i + 1, j, k) - nodes(i, j, k)) * v;
    }

    // The same `u` of the way across.
    double at(int64_t i, int64_t j, double v, double u, int k) const {
        const double left = down(i, j, v, k);
        return left + (down(i, j + 1, v, k) - left) * u;
    }
};

// What `Relief` holds. Where a cell rises by `share` of what a line of sight does, it is a wall to it.
struct Relief {
    Heights heights, tiles, walls;
    double top, share;
    int64_t tile;
};

// A cell's highest node, −inf where none is known, and its height above the lowest.
struct Cell {
    float high = -INFINITY, rise;

    Cell(const Heights &heights, int64_t row, int64_t col) {
        const float *above = heights.row(row) + col, *under = heights.row(row + 1) + col;
        const float nodes[] = {above[0], above[1], under[0], under[1]};
        float low = INFINITY;
        for (const float node : nodes) {
            high = node > high ? node : high;
            low = node < low ? node : low;
        }
        rise = high - low;
    }
};

// Bounds in nodes, or of slopes.
struct Box {
    double x_low = NEVER, x_high = -NEVER, y_low = NEVER, y_high = -NEVER;

    void widen(double x, double y, double x_more = 0.0, double y_more = 0.0) {
        x_low = smaller(x_low, x - x_more), x_high = larger(x_high, x + x_more);
        y_low = smaller(y_low, y - y_more), y_high = larger(y_high, y + y_more);
    }
};

// Whether 0 <= index < number, in one comparison.
bool within(int64_t index, int64_t number) { return static_cast<uint64_t>(index) < static_cast<uint64_t>(number); }

// The whole number below a place, within 0 and the last.
int64_t below(double place, int64_t last) {
    const double whole = floor(place);
    return whole >= static_cast<double>(last) ? last : whole >= 0.0 ? static_cast<int64_t>(whole) : 0;
}

// Whether a tile that meets a box is above a level; a cell around the box counts too, for the sake of rounding.
bool over(const Heights &tiles, int64_t tile, const Box &box, double level) {
    const auto [x_low, x_high, y_low, y_high] = box;
    if (x_high + 1.0 < 0.0 || y_high + 1.0 < 0.0) return false;
    const int64_t rows = tiles.shape[0], cols = tiles.shape[1];
    const int64_t last_row = below((y_high + 1.0) / tile, rows - 1), last_col = below((x_high + 1.0) / tile, cols - 1);
    for (int64_t r = below((y_low - 1.0) / tile, rows); r <= last_row; r++)
        for (int64_t c = below((x_low - 1.0) / tile, cols); c <= last_col; c++)
            if (tiles(r, c) > level - 1e-3) return true;
    return false;
}

// Level in metres beyond which nothing is in the way of the lines of sight from a group of places; −inf where nothing
// is in the way at all.
double last_level(const Field &field, const Relief &relief, int64_t first_row, int64_t first_col) {
    // What all lines pass between two heights lies in a box. Up to `NEAR` nodes away only walls count.
    const auto &[heights, tiles, walls, top, share, tile] = relief;
    const int64_t i = first_row / field.step, j = first_col / field.step;
    const double v = static_cast<double>(first_row) / field.step - i, u = static_cast<double>(first_col) / field.step - j;
    const double size = static_cast<double>(GROUP) / field.step;
    const auto corners = [&](auto look) {
        for (int a = 0; a < 2; a++)
            for (int b = 0; b < 2; b++) look([&](int k) { return field.at(i, j, v + a * size, u + b * size, k); });
    };
    Box places;
    corners([&](auto value) { places.widen(value(0), value(1)); });
    if (!(isfinite(places.x_low + places.x_high) && isfinite(places.y_low + places.y_high))) return top;
    // Of the nodes that their heights are interpolated from.
    double lowest = NEVER, highest = -NEVER;
    if (places.x_high + 1e-6 >= -1.0 && places.y_high + 1e-6 >= -1.0) {
        const int64_t rows = heights.shape[0], cols = heights.shape[1];
        const int64_t last_row = below(places.y_high + 1e-6 + 1.0, rows - 1);
        const int64_t last_col = below(places.x_high + 1e-6 + 1.0, cols - 1);
        for (int64_t r = below(places.y_low - 1e-6, rows); r <= last_row; r++)
            for (int64_t c = below(places.x_low - 1e-6, cols); c <= last_col; c++) {
                const double z = heights(r, c);
                lowest = z < lowest ? z : lowest, highest = z > highest ? z : highest;
            }
    }
    if (!(lowest < top)) return -NEVER;
    const double ends[] = {(lowest - field.z_middle) * field.z_inverse, (highest - field.z_middle) * field.z_inverse};
    // A quadratic leaves its chord over an interval h by at most h² / 4 times its leading coefficient.
    const double bulge = (ends[1] - ends[0]) * (ends[1] - ends[0]) / 4.0;
    Box slopes;
    bool known = true;
    corners([&](auto value) {
        const double x0 = value(2), x1 = value(3), x2 = value(4), y0 = value(5), y1 = value(6), y2 = value(7);
        for (const double t : ends) {
            const double sx = x0 + t * (x1 + t * x2), sy = y0 + t * (y1 + t * y2);
            known = known && isfinite(sx) && isfinite(sy);
            slopes.widen(sx, sy, bulge * fabs(x2), bulge * fabs(y2));
        }
    });
    if (!known) return top;
    const double x_most = larger(fabs(slopes.x_low), fabs(slopes.x_high));
    const double y_most = larger(fabs(slopes.y_low), fabs(slopes.y_high));
    const double longest = sqrt(x_most * x_most + y_most * y_most);
    const double start = lowest + (longest > 1e-12 ? NEAR / longest : NEVER);
    const double part = (top - start) / PARTS;
    for (int64_t k = PARTS - 1; k >= 0; k--) {
        const double level = start + k * part;
        if (!(level < top)) continue;
        const double least = larger(0.0, level - highest), most = level + part - lowest;
        const Box passed{
            places.x_low + smaller(slopes.x_low * least, slopes.x_low * most),
            places.x_high + larger(slopes.x_high * least, slopes.x_high * most),
            places.y_low + smaller(slopes.y_low * least, slopes.y_low * most),
            places.y_high + larger(slopes.y_high * least, slopes.y_high * most),
        };
        // A millimetre more, for rounding: who follows a line too far loses time only.
        if (over(tiles, tile, passed, level)) return smaller(top, level + part + 1e-3);
    }
    const Box near{places.x_low - NEAR, places.x_high + NEAR, places.y_low - NEAR, places.y_high + NEAR};
    return over(walls, tile, near, lowest) ? smaller(top, start + 1e-3) : -NEVER;
}

// Height between nodes; NaN beyond them and where one is unknown.
double height_between(const Heights &heights, double x, double y) {
    if (!(x >= 0.0 && y >= 0.0 && x < heights.shape[1] - 1 && y < heights.shape[0] - 1)) return NAN;
    const int64_t i = static_cast<int64_t>(y), j = static_cast<int64_t>(x);
    const double u = x - j, v = y - i;
    const double above = heights(i, j) * (1.0 - u) + heights(i, j + 1) * u;
    const double under = heights(i + 1, j) * (1.0 - u) + heights(i + 1, j + 1) * u;
    return above * (1.0 - v) + under * v;
}

// Foot of the wall that a place may stand on, the lowest of the nodes around it; NaN where nodes differ by no more than
// `wall` metres.
double foot(const Heights &heights, double x, double y, double wall) {
    const int64_t i = static_cast<int64_t>(y), j = static_cast<int64_t>(x);
    double low = NEVER, high = -NEVER;
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++)
            if ((a ? y - i : 1.0 - (y - i)) > TOUCH && (b ? x - j : 1.0 - (x - j)) > TOUCH) {
                const double node = heights(i + a, j + b);
                low = smaller(low, node), high = larger(high, node);
            }
    return high - low > wall ? low : NAN;
}

// Whether what rises above a level may keep a line of sight from leaving the cell that it starts in, by an edge across x
// or across y.
bool shut(const Heights &heights, int64_t row, int64_t col, bool by_x, double ux, double uy, double least) {
    const bool a = heights(row, col) > least, b = heights(row, col + 1) > least;
    const bool c = heights(row + 1, col) > least, d = heights(row + 1, col + 1) > least;
    if (by_x ? (ux > 0.0 ? b || d : a || c) : (uy > 0.0 ? c || d : a || b)) return true;
    if (a + b + c + d != 1) return false;
    return (ux != 0.0 && (b || d) == (ux > 0.0)) || (uy != 0.0 && (c || d) == (uy > 0.0));
}

// A line of sight from a place at height z: its direction over the ground, of unit length, and metres per node along it.
struct Line {
    double x, y, z, ux, uy, rise;
};

// Whether the surface is in the way of a line of sight below the level `end`.
bool blocked(const Line &line, const Relief &relief, double wall, double end) {
    const Heights &heights = relief.heights;
    const int64_t high = heights.shape[0] - 1, wide = heights.shape[1] - 1, tile = relief.tile;
    const auto [x, y, z, ux, uy, rise] = line;
    const double low = foot(heights, x, y, wall);
    bool beside = low == low, empty = false;
    const double first = beside ? low : z;
    int64_t col = static_cast<int64_t>(x), row = static_cast<int64_t>(y);
    const int64_t step_x = ux > 0.0 ? 1 : -1, step_y = uy > 0.0 ? 1 : -1;
    const double across = fabs(1.0 / ux), down = fabs(1.0 / uy);
    double next_x = ux == 0.0 ? NEVER : (col + (ux > 0.0) - x) / ux;
    double next_y = uy == 0.0 ? NEVER : (row + (uy > 0.0) - y) / uy;
    // First cell of the tile that the line is in.
    int64_t tile_col = -tile, tile_row = -tile;
    for (double t = 0.0;;) {
        const double level = first + rise * t;
        if (!(within(col, wide) && within(row, high) && level < end)) return false;
        if (!(within(col - tile_col, tile) && within(row - tile_row, tile))) {
            empty = relief.tiles(row / tile, col / tile) <= level;
            tile_col = col / tile * tile, tile_row = row / tile * tile;
        }
        const double leave = smaller(next_x, next_y);
        if (leave > t + TOUCH) {
            if (beside) {
                beside = false;
                if (shut(heights, row, col, next_x <= next_y, ux, uy, low + wall)) return true;
            } else if (!empty) {
                const Cell cell(heights, row, col);
                if (cell.high > level && (t >= NEAR || cell.rise > wall)) return true;
            }
        }
        if (next_x <= next_y)
            col += step_x, next_x += across;
        else
            row += step_y, next_y += down;
        t = leave;
    }
}

// Highest of a tile's cells that rise by more than `least`, −inf where none does; brings the largest rises along columns
// and rows up to date.
float highest_wall(
    const Heights &heights, int64_t row, int64_t last_row, int64_t first, int64_t last, double least, float *rises
) {
    float wall = -INFINITY, along = rises[0], down = rises[1];
    for (; row < last_row; row++)
        for (int64_t col = first; col < last; col++) {
            const float p = heights(row, col), q = heights(row, col + 1);
            const float r = heights(row + 1, col), s = heights(row + 1, col + 1);
            const float across = fabsf(q - p), under = fabsf(s - r), left = fabsf(r - p), right = fabsf(s - q);
            along = across > along ? across : along, along = under > along ? under : along;
            down = left > down ? left : down, down = right > down ? right : down;
            const Cell cell(heights, row, col);
            const float high = cell.rise > least ? cell.high : -INFINITY;
            wall = high > wall ? high : wall;
        }
    rises[0] = along, rises[1] = down;
    return wall;
}

// Nodes before and after a pixel, −1 beyond all, and the way between them.
struct Between {
    int64_t first, last;
    double way;
};

void place(Between *places, int64_t number, double step, double start, int64_t nodes) {
    for (int64_t k = 0; k < number; k++) {
        double x = step * k + start;
        const bool inside = x >= -0.5 && x <= nodes - 0.5;
        x = inside ? larger(x, 0.0) : 0.0;
        const int64_t i = smaller(static_cast<int64_t>(x), nodes - 1);
        places[k] = {inside ? i : -1, smaller(i + 1, nodes - 1), x - i > TOUCH ? x - i : 0.0};
    }
}

// Height between four nodes, `u` to the right and `v` down; on either side of a wall that of its own side.
double height_beside(const double (&nodes)[4], double u, double v, double wall) {
    const double weights[] = {(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v};
    double z = 0.0, low = NEVER, high = -NEVER;
    for (int k = 0; k < 4; k++)
        if (weights[k] > TOUCH) {
            z += weights[k] * nodes[k];
            low = nodes[k] < low ? nodes[k] : low, high = nodes[k] > high ? nodes[k] : high;
        }
    if (!(high - low > wall) || z != z) return z;
    const double middle = (low + high) / 2.0;
    double total = 0.0, weight = 0.0;
    for (int k = 0; k < 4; k++)
        if (weights[k] > TOUCH && (nodes[k] > middle) == (z > middle)) total += weights[k] * nodes[k], weight += weights[k];
    return total / weight;
}

}  // namespace

// `rises` become 0 where they are below `gentle`: most tiles are even, and only of the others each cell is looked at.
KERNEL int64_t prepare_relief(
    const Array *patch, double least, double gentle, int64_t tile, const Array *tiles, const Array *walls,
    const Array *rises
) {
    const Heights heights(patch), highest(tiles), wall(walls);
    const int64_t rows = heights.shape[0], cols = heights.shape[1];
    float *steepest = View<float, 1>(rises).data;
    steepest[0] = steepest[1] = 0.0f;
    const Buffer<float> high(cols), low(cols);
    for (int64_t i = 0; i < highest.shape[0]; i++) {
        const int64_t first = i * tile, last = smaller(first + tile + 1, rows);
        for (int64_t col = 0; col < cols; col++) high[col] = -INFINITY, low[col] = INFINITY;
        for (int64_t row = first; row < last; row++) {
            const float *line = heights.row(row);
            for (int64_t col = 0; col < cols; col++) {
                const float z = line[col];
                high[col] = z > high[col] ? z : high[col];
                low[col] = z < low[col] ? z : low[col];
            }
        }
        for (int64_t j = 0; j < highest.shape[1]; j++) {
            const int64_t end = smaller(j * tile + tile + 1, cols);
            float most = -INFINITY, lowest = INFINITY;
            for (int64_t col = j * tile; col < end; col++) {
                most = high[col] > most ? high[col] : most;
                lowest = low[col] < lowest ? low[col] : lowest;
            }
            const double rise = static_cast<double>(most) - lowest;
            const bool uneven = rise > least || rise > gentle;
            highest(i, j) = most;
            wall(i, j) = uneven ? highest_wall(heights, first, last - 1, j * tile, end - 1, least, steepest) : -INFINITY;
        }
    }
    return 0;
}

KERNEL int64_t hidden(
    const Array *nodes, double z_middle, double z_inverse, int64_t step, const Array *patch, const Array *tiles,
    const Array *walls, double top, int64_t tile, double share, double widest, const Array *wanted, const Array *out
) {
    const Field field{nodes, z_middle, z_inverse, widest, step};
    const Relief relief{patch, tiles, walls, top, share, tile};
    const View<uint8_t, 2> asked(wanted), found(out);
    const int64_t rows = asked.shape[0], cols = asked.shape[1];
    const auto follow_row = [&](int64_t row, int64_t first_col, int64_t last_col, double end) {
        const int64_t i = row / step, j = first_col / step;
        const double v = (row + 0.5) / step - i;
        double left[8], change[8], at[8];
        for (int k = 0; k < 8; k++) left[k] = field.down(i, j, v, k), change[k] = field.down(i, j + 1, v, k) - left[k];
        for (int64_t col = first_col; col < last_col; col++) {
            if (!asked(row, col)) continue;
            const double u = (col + 0.5) / step - j;
            for (int k = 0; k < 8; k++) at[k] = left[k] + change[k] * u;
            const double z = height_between(relief.heights, at[0], at[1]);
            if (!(z < top)) continue;  // nor where it is not known
            const double t = (z - z_middle) * z_inverse;
            const double sx = at[2] + t * (at[3] + t * at[4]), sy = at[5] + t * (at[6] + t * at[7]);
            const double length = sqrt(sx * sx + sy * sy);
            if (!(length > 1e-12)) continue;
            const double rise = 1.0 / length;
            const Line line{at[0], at[1], z, sx * rise, sy * rise, rise};
            found(row, col) = blocked(line, relief, smaller(share * rise, widest), end);
        }
    };
    for (int64_t first_row = 0; first_row < rows; first_row += GROUP)
        for (int64_t first_col = 0; first_col < cols; first_col += GROUP) {
            const int64_t last_row = smaller(first_row + GROUP, rows), last_col = smaller(first_col + GROUP, cols);
            bool any = false;
            for (int64_t row = first_row; row < last_row && !any; row++)
                for (int64_t col = first_col; col < last_col && !any; col++) any = asked(row, col);
            const double end = any ? last_level(field, relief, first_row, first_col) : -NEVER;
            if (!(end > -NEVER)) continue;
            for (int64_t row = first_row; row < last_row; row++) follow_row(row, first_col, last_col, end);
        }
    return 0;
}

KERNEL int64_t upright(const Array *patch, double a, double b, double c, double d, double wall, const Array *out) {
    const Heights heights(patch), found(out);
    const int64_t rows = found.shape[0], cols = found.shape[1];
    const Buffer<Between> across(cols), down(rows);
    place(across, cols, a, b, heights.shape[1]);
    place(down, rows, c, d, heights.shape[0]);
    for (int64_t row = 0; row < rows; row++)
        for (int64_t col = 0; col < cols; col++) {
            const auto [left, right, u] = across[col];
            const auto [above, under, v] = down[row];
            if (left < 0 || above < 0) {
                found(row, col) = NAN;
                continue;
            }
            const float p = heights(above, left), q = heights(above, right);
            const float r = heights(under, left), s = heights(under, right);
            if (p == q && p == r && p == s)
                found(row, col) = p;
            else
                found(row, col) = static_cast<float>(height_beside({p, q, r, s}, u, v, wall));
        }
    return 0;
}
