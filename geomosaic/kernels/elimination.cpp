// Normal equations of blocks: points are eliminated, what is left of the parameters lies within an envelope.
//
// Observations of a point stand in `order` from start[point] to start[point + 1]. Parameters have a place in the reduced
// equations, or -1. Those that a point's observations touch are `local`, from from[point] to from[point + 1], ascending;
// W (coordinates, local parameters) of a point lies from D * from[point] on.

#include <string.h>

#include "envelope.hpp"

// Observations of one group, without gaps: N of K components, with P parameters and D coordinates.
struct Group {
    const int64_t *columns;
    const double *by_parameters, *by_point;
    int64_t count, components, terms, dimensions;

    Group(const Array *columns, const Array *by_parameters, const Array *by_point)
        : columns(static_cast<const int64_t *>(columns->data)),
          by_parameters(static_cast<const double *>(by_parameters->data)),
          by_point(static_cast<const double *>(by_point->data)),
          count(by_parameters->shape[0]),
          components(by_parameters->shape[1]),
          terms(by_parameters->shape[2]),
          dimensions(by_point->shape[2]) {}

    const int64_t *columns_of(int64_t n) const { return columns + n * terms; }
    const double *parameters_row(int64_t n, int64_t k) const { return by_parameters + (n * components + k) * terms; }
    const double *point_row(int64_t n, int64_t k) const { return by_point + (n * components + k) * dimensions; }
};

// Parameters that each point touches.
struct Touched {
    const int64_t *from, *local;

    Touched(const Array *from, const Array *local)
        : from(static_cast<const int64_t *>(from->data)), local(static_cast<const int64_t *>(local->data)) {}

    int64_t count(int64_t point) const { return from[point + 1] - from[point]; }
    const int64_t *of(int64_t point) const { return local + from[point]; }
};

// Places (or blocks) that the observations of each point touch, ascending: counted into from[point + 1] where `local`
// is empty, else written, and `lowest` (places,) brought down to the least that each place meets.
KERNEL int64_t find_touched(
    const Array *start, const Array *order, const Array *columns, const Array *place, int64_t places, const Array *from,
    const Array *local, const Array *lowest
) {
    const View<int64_t, 1> begin(start), rows(order), place_of(place), first(from), found(local), least(lowest);
    const View<int64_t, 2> column(columns);
    const int64_t words = (places + 63) / 64;
    const Buffer<uint64_t> bits(words);
    for (int64_t w = 0; w < words; w++) bits[w] = 0;
    for (int64_t point = 0; point + 1 < begin.shape[0]; point++) {
        int64_t low = words, high = 0;
        for (int64_t r = begin(point); r < begin(point + 1); r++)
            for (int64_t p = 0; p < column.shape[1]; p++) {
                const int64_t own = column(rows(r), p), at = own < 0 ? -1 : place_of(own);
                if (at < 0) continue;
                bits[at / 64] |= uint64_t(1) << at % 64;
                low = smaller(low, at / 64), high = larger(high, at / 64 + 1);
            }
        int64_t count = 0;
        for (int64_t w = low; w < high; w++) {
            uint64_t left = bits[w];
            bits[w] = 0;
            if (found.shape[0] == 0) count += __builtin_popcountll(left);
            else
                for (; left; left &= left - 1) found(first(point) + count++) = w * 64 + __builtin_ctzll(left);
        }
        if (found.shape[0] == 0) first(point + 1) = count;
        else
            for (int64_t k = 0; k < count; k++) {
                const int64_t at = found(first(point) + k);
                least(at) = smaller(least(at), found(first(point)));
            }
    }
    return 0;
}

// V (S, D, D) and W of points from `low` to `high`, added to by one group; held coordinates have `moving` 0.
KERNEL int64_t gather_points(
    const Array *start, const Array *order, const Array *columns, const Array *by_parameters, const Array *by_point,
    const Array *place, const Array *moving, const Array *from, const Array *local, const Array *normal,
    const Array *mixed, int64_t low, int64_t high
) {
    const Group group(columns, by_parameters, by_point);
    const Touched touched(from, local);
    const View<int64_t, 1> begin(start), rows(order), place_of(place);
    const View<uint8_t, 2> moves(moving);
    const int64_t d = group.dimensions, terms = group.terms;
    double *const v = static_cast<double *>(normal->data), *const w = static_cast<double *>(mixed->data);
    // Where a place stands among those of the point.
    const Buffer<int64_t> among(place->shape[0] + 1);
    const Buffer<int64_t> at(terms + 1);
    for (int64_t point = low; point < high; point++) {
        const int64_t count = touched.count(point), *const own = touched.of(point);
        for (int64_t i = 0; i < count; i++) among[own[i]] = i;
        double *const v_own = v + point * d * d, *const w_own = w + touched.from[point] * d;
        for (int64_t r = begin(point); r < begin(point + 1); r++) {
            const int64_t n = rows(r);
            for (int64_t p = 0; p < terms; p++) {
                const int64_t column = group.columns_of(n)[p], placed = column < 0 ? -1 : place_of(column);
                at[p] = placed < 0 ? -1 : among[placed];
            }
            for (int64_t k = 0; k < group.components; k++) {
                const double *const a = group.parameters_row(n, k), *const g = group.point_row(n, k);
                for (int64_t e = 0; e < d; e++) {
                    if (!moves(point, e)) continue;
                    for (int64_t f = 0; f < d; f++)
                        if (moves(point, f)) v_own[e * d + f] += g[e] * g[f];
                    for (int64_t p = 0; p < terms; p++)
                        if (at[p] >= 0) w_own[e * count + at[p]] += g[e] * a[p];
                }
            }
        }
    }
    return 0;
}

// Inverses (S, D, D) of V with a damping of the diagonal, and Z = V^-1 W, of points from `low` to `high`. Held
// coordinates have zeros in V and in the inverse. Where V is not positive, the inverse is NaN.
KERNEL int64_t invert_points(
    const Array *normal, const Array *mixed, const Array *moving, const Array *from, double damping,
    const Array *inverses, const Array *solved, int64_t low, int64_t high
) {
    const int64_t d = normal->shape[1], *const begin = static_cast<const int64_t *>(from->data);
    const View<uint8_t, 2> moves(moving);
    for (int64_t point = low; point < high; point++) {
        const double *const v = static_cast<const double *>(normal->data) + point * d * d;
        double *const inverse = static_cast<double *>(inverses->data) + point * d * d;
        double l[9] = {}, u[9] = {};
        bool positive = true;
        // Cholesky factor l, then u = l^-1; held coordinates are left out of both.
        for (int64_t j = 0; j < d; j++) {
            if (!moves(point, j)) continue;
            for (int64_t i = j; i < d; i++) {
                if (!moves(point, i)) continue;
                double sum = i == j ? v[i * d + i] + damping * v[i * d + i] : v[i * d + j];
                for (int64_t k = 0; k < j; k++) sum -= l[i * d + k] * l[j * d + k];
                if (i == j) positive = positive && sum > 0.0, l[j * d + j] = sqrt(sum);
                else l[i * d + j] = sum / l[j * d + j];
            }
            u[j * d + j] = 1.0 / l[j * d + j];
        }
        for (int64_t j = 0; j < d; j++)
            for (int64_t i = j + 1; i < d; i++) {
                if (!moves(point, i) || !moves(point, j)) continue;
                double sum = 0.0;
                for (int64_t k = j; k < i; k++) sum += l[i * d + k] * u[k * d + j];
                u[i * d + j] = -sum / l[i * d + i];
            }
        for (int64_t i = 0; i < d; i++)
            for (int64_t j = 0; j < d; j++) {
                double sum = 0.0;
                for (int64_t k = larger(i, j); k < d; k++) sum += u[k * d + i] * u[k * d + j];
                inverse[i * d + j] = positive ? sum : NAN;
            }
        const int64_t count = begin[point + 1] - begin[point];
        const double *const w = static_cast<const double *>(mixed->data) + begin[point] * d;
        double *const z = static_cast<double *>(solved->data) + begin[point] * d;
        for (int64_t e = 0; e < d; e++)
            for (int64_t i = 0; i < count; i++) {
                double sum = 0.0;
                for (int64_t f = 0; f < d; f++) sum += inverse[e * d + f] * w[f * count + i];
                z[e * count + i] = sum;
            }
    }
    return 0;
}

// What one group adds to the normal equations of the parameters, before points are eliminated; what lies outside of the
// envelope is left out.
KERNEL int64_t gather_parameters(
    const Array *columns, const Array *by_parameters, const Array *by_point, const Array *place, const Array *first,
    const Array *offset, const Array *tiles
) {
    const Group group(columns, by_parameters, by_point);
    const View<int64_t, 1> place_of(place);
    const Envelope matrix(first, offset, tiles);
    const int64_t terms = group.terms;
    const Buffer<double> sums(terms * terms + 1);
    // Observations of the same parameters, one after the other, are those of one image: they are summed first.
    for (int64_t n = 0, next; n < group.count; n = next) {
        const int64_t *const own = group.columns_of(n);
        for (int64_t k = 0; k < terms * terms; k++) sums[k] = 0.0;
        for (next = n; next < group.count && !memcmp(group.columns_of(next), own, terms * sizeof(int64_t)); next++)
            for (int64_t k = 0; k < group.components; k++) {
                const double *const a = group.parameters_row(next, k);
                double *const local = sums;
                for (int64_t p = 0; p < terms; p++)
                    for (int64_t q = 0; q < terms; q++) local[p * terms + q] += a[p] * a[q];
            }
        for (int64_t p = 0; p < terms; p++)
            for (int64_t q = 0; q < terms; q++) {
                const int64_t i = own[p] < 0 ? -1 : place_of(own[p]), j = own[q] < 0 ? -1 : place_of(own[q]);
                if (j >= 0 && i >= j && matrix.has(i, j)) matrix(i, j) += sums[p * terms + q];
            }
    }
    return 0;
}

// The matrix less W' V^-1 W of every point, in its columns from `low` to `high` and within the envelope.
KERNEL int64_t subtract_points(
    const Array *from, const Array *local, const Array *mixed, const Array *solved, const Array *first,
    const Array *offset, const Array *tiles, int64_t dimensions, int64_t low, int64_t high
) {
    const Touched touched(from, local);
    const Envelope matrix(first, offset, tiles);
    const int64_t d = dimensions;
    struct Run {
        int64_t begin, end, first;
        double *row;
    };
    const Buffer<Run> runs(matrix.count * TILE + 1);
    const Buffer<double> sums(matrix.count * TILE + 1);
    for (int64_t point = 0; point + 1 < from->shape[0]; point++) {
        const int64_t count = touched.count(point), *const own = touched.of(point);
        if (count == 0 || own[0] >= high || own[count - 1] < low) continue;
        // Neighbours within a row of tiles, which are neighbours in memory, too.
        int64_t number = 0;
        for (int64_t i = 0, next; i < count; i = next) {
            for (next = i + 1; next < count && own[next] == own[next - 1] + 1 && own[next] % TILE; next++) {}
            runs[number++] = {i, next, matrix.first[own[i] / TILE], matrix.tile(own[i] / TILE, 0) + own[i] % TILE - i};
        }
        const double *const w = static_cast<const double *>(mixed->data) + touched.from[point] * d;
        const double *const z = static_cast<const double *>(solved->data) + touched.from[point] * d;
        for (int64_t j = 0, run = 0; j < count && own[j] < high; j++) {
            if (j == runs[run].end) run++;
            if (own[j] < low) continue;
            double *const __restrict sum = sums;
            for (int64_t i = j; i < count; i++) sum[i] = w[i] * z[j];
            for (int64_t e = 1; e < d; e++) {
                const double *const __restrict row = w + e * count;
                const double factor = z[e * count + j];
                for (int64_t i = j; i < count; i++) sum[i] += row[i] * factor;
            }
            const int64_t column = own[j] / TILE * (TILE * TILE) + own[j] % TILE * TILE;
            for (int64_t r = run; r < number; r++) {
                if (own[j] / TILE < runs[r].first) continue;
                double *const __restrict to = runs[r].row + column;
                for (int64_t i = larger(runs[r].begin, j); i < runs[r].end; i++) to[i] -= sum[i];
            }
        }
    }
    return 0;
}

// Right-hand sides (M, places) less W' V^-1 times those of the points (M, S, D).
KERNEL int64_t subtract_sides(
    const Array *from, const Array *local, const Array *solved, const Array *of_points, const Array *right
) {
    const Touched touched(from, local);
    const View<double, 3> sides(of_points);
    const View<double, 2> to(right);
    const int64_t d = sides.shape[2];
    for (int64_t side = 0; side < sides.shape[0]; side++)
        for (int64_t point = 0; point < sides.shape[1]; point++) {
            const int64_t count = touched.count(point), *const own = touched.of(point);
            const double *const z = static_cast<const double *>(solved->data) + touched.from[point] * d;
            for (int64_t e = 0; e < d; e++)
                for (int64_t i = 0; i < count; i++) to(side, own[i]) -= z[e * count + i] * sides(side, point, e);
        }
    return 0;
}

// Coordinates (M, S, D) from right-hand sides in their place and the parameters (M, places), points `low` to `high`.
KERNEL int64_t solve_points(
    const Array *from, const Array *local, const Array *solved, const Array *inverses, const Array *parameters,
    const Array *of_points, int64_t low, int64_t high
) {
    const Touched touched(from, local);
    const View<double, 3> sides(of_points), inverse(inverses);
    const View<double, 2> known(parameters);
    const int64_t d = sides.shape[2];
    for (int64_t side = 0; side < sides.shape[0]; side++)
        for (int64_t point = low; point < high; point++) {
            const int64_t count = touched.count(point), *const own = touched.of(point);
            const double *const z = static_cast<const double *>(solved->data) + touched.from[point] * d;
            double found[3];
            for (int64_t e = 0; e < d; e++) {
                found[e] = 0.0;
                for (int64_t f = 0; f < d; f++) found[e] += inverse(point, e, f) * sides(side, point, f);
                for (int64_t i = 0; i < count; i++) found[e] -= z[e * count + i] * known(side, own[i]);
            }
            for (int64_t e = 0; e < d; e++) sides(side, point, e) = found[e];
        }
    return 0;
}

// A dx (N, K) of a group.
KERNEL int64_t multiply(
    const Array *point, const Array *columns, const Array *by_parameters, const Array *by_point,
    const Array *parameters, const Array *coordinates, const Array *product
) {
    const Group group(columns, by_parameters, by_point);
    const View<int64_t, 1> point_of(point);
    const double *const x = static_cast<const double *>(parameters->data);
    const double *const places = static_cast<const double *>(coordinates->data);
    double *to = static_cast<double *>(product->data);
    for (int64_t n = 0; n < group.count; n++)
        for (int64_t k = 0; k < group.components; k++) {
            const double *const a = group.parameters_row(n, k), *const g = group.point_row(n, k);
            double sum = 0.0;
            for (int64_t p = 0; p < group.terms; p++) {
                const int64_t column = group.columns_of(n)[p];
                if (column >= 0) sum += a[p] * x[column];
            }
            if (point_of(n) >= 0)
                for (int64_t e = 0; e < group.dimensions; e++) sum += g[e] * places[point_of(n) * group.dimensions + e];
            *to++ = sum;
        }
    return 0;
}

// A' v of a group, v (N, K), added to parameters (U,) and coordinates (S, D).
KERNEL int64_t multiply_turned(
    const Array *point, const Array *columns, const Array *by_parameters, const Array *by_point, const Array *values,
    const Array *parameters, const Array *coordinates
) {
    const Group group(columns, by_parameters, by_point);
    const View<int64_t, 1> point_of(point);
    const double *value = static_cast<const double *>(values->data);
    double *const x = static_cast<double *>(parameters->data), *const places = static_cast<double *>(coordinates->data);
    for (int64_t n = 0; n < group.count; n++)
        for (int64_t k = 0; k < group.components; k++, value++) {
            const double *const a = group.parameters_row(n, k), *const g = group.point_row(n, k);
            for (int64_t p = 0; p < group.terms; p++) {
                const int64_t column = group.columns_of(n)[p];
                if (column >= 0) x[column] += a[p] * *value;
            }
            if (point_of(n) >= 0)
                for (int64_t e = 0; e < group.dimensions; e++)
                    places[point_of(n) * group.dimensions + e] += g[e] * *value;
        }
    return 0;
}

// Cofactors (S, D, D) of points from `low` to `high`, from V^-1 in their place; and where `mutual` is not empty, those of
// coordinates against the parameters that the point touches, laid out as W.
KERNEL int64_t point_cofactors(
    const Array *from, const Array *local, const Array *solved, const Array *first, const Array *offset,
    const Array *inverse, const Array *cofactors, const Array *mutual, int64_t low, int64_t high
) {
    const Touched touched(from, local);
    const Envelope cofactor(first, offset, inverse);
    const int64_t d = cofactors->shape[1];
    const Buffer<double> kept(3 * cofactor.count * TILE + 1);
    for (int64_t point = low; point < high; point++) {
        const int64_t count = touched.count(point), *const own = touched.of(point);
        const double *const z = static_cast<const double *>(solved->data) + touched.from[point] * d;
        double *const q = static_cast<double *>(cofactors->data) + point * d * d;
        double *const turned = kept;
        for (int64_t i = 0; i < d * count; i++) turned[i] = 0.0;
        for (int64_t i = 0; i < count; i++)
            for (int64_t j = 0; j <= i; j++) {
                const double value = cofactor.known(own[i], own[j]);
                for (int64_t e = 0; e < d; e++) {
                    turned[e * count + i] += value * z[e * count + j];
                    if (j < i) turned[e * count + j] += value * z[e * count + i];
                }
            }
        for (int64_t e = 0; e < d; e++)
            for (int64_t f = 0; f < d; f++)
                for (int64_t i = 0; i < count; i++) q[e * d + f] += z[e * count + i] * turned[f * count + i];
        if (mutual->shape[0]) {
            double *const to = static_cast<double *>(mutual->data) + touched.from[point] * d;
            for (int64_t i = 0; i < d * count; i++) to[i] = -turned[i];
        }
    }
    return 0;
}

// A Q A' (N, K, K) of a group's observations from `low` to `high`.
KERNEL int64_t observation_cofactors(
    const Array *point, const Array *columns, const Array *by_parameters, const Array *by_point, const Array *place,
    const Array *from, const Array *local, const Array *cofactors, const Array *mutual, const Array *first,
    const Array *offset, const Array *inverse, const Array *found, int64_t low, int64_t high
) {
    const Group group(columns, by_parameters, by_point);
    const Touched touched(from, local);
    const View<int64_t, 1> point_of(point), place_of(place);
    const Envelope cofactor(first, offset, inverse);
    const int64_t terms = group.terms, d = group.dimensions, size = group.components;
    // Derivatives times cofactors, of the parameters and then of the coordinates.
    const Buffer<double> product(terms + d + 1);
    const Buffer<int64_t> at(terms + 1), among(terms + 1);
    for (int64_t n = low; n < high; n++) {
        const int64_t own = point_of(n), count = own < 0 ? 0 : touched.count(own);
        const double *const q = static_cast<const double *>(cofactors->data) + (own < 0 ? 0 : own * d * d);
        const double *const mixed = static_cast<const double *>(mutual->data) + (own < 0 ? 0 : touched.from[own] * d);
        double *const to = static_cast<double *>(found->data) + n * size * size;
        for (int64_t p = 0; p < terms; p++) {
            const int64_t column = group.columns_of(n)[p];
            at[p] = column < 0 ? -1 : place_of(column);
            if (own < 0 || at[p] < 0) continue;
            // Bisection among the ascending places of the point.
            int64_t low_end = 0, high_end = count - 1;
            while (low_end < high_end) {
                const int64_t middle = (low_end + high_end) / 2;
                if (touched.of(own)[middle] < at[p]) low_end = middle + 1;
                else high_end = middle;
            }
            among[p] = low_end;
        }
        for (int64_t k = 0; k < size; k++) {
            const double *const a = group.parameters_row(n, k), *const g = group.point_row(n, k);
            for (int64_t p = 0; p < terms + d; p++) product[p] = 0.0;
            for (int64_t p = 0; p < terms; p++) {
                if (at[p] < 0) continue;
                for (int64_t o = 0; o < terms; o++)
                    if (at[o] >= 0) product[p] += cofactor.symmetric(at[p], at[o]) * a[o];
                for (int64_t e = 0; own >= 0 && e < d; e++) {
                    product[p] += mixed[e * count + among[p]] * g[e];
                    product[terms + e] += mixed[e * count + among[p]] * a[p];
                }
            }
            for (int64_t e = 0; own >= 0 && e < d; e++)
                for (int64_t f = 0; f < d; f++) product[terms + e] += q[e * d + f] * g[f];
            for (int64_t m = 0; m < size; m++) {
                double sum = 0.0;
                for (int64_t p = 0; p < terms; p++)
                    if (at[p] >= 0) sum += group.parameters_row(n, m)[p] * product[p];
                for (int64_t e = 0; e < d; e++) sum += group.point_row(n, m)[e] * product[terms + e];
                to[k * size + m] = sum;
            }
        }
    }
    return 0;
}
