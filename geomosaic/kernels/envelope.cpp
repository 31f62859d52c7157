// Symmetric matrices within an envelope: Cholesky factor, solution, and the inverse within the same envelope.
//
// A matrix is cut into tiles of TILE x TILE numbers, column after column. Row I of tiles begins at column first[I] and
// ends with the diagonal tile; the tiles of all rows lie one after the other, those of row I from offset[I] on.
// `estimation/envelope.py` makes these lists, and pads the matrix with a unit diagonal.

#include "envelope.hpp"

// Rows of a product that are held in registers, in lanes, and columns: as many sums as there are registers for.
#ifdef __AVX512F__
constexpr int64_t HIGH = 2, WIDE = 4;
#else
constexpr int64_t HIGH = 1, WIDE = 4;
#endif
constexpr int64_t LANES = 8;
typedef double Lanes __attribute__((vector_size(8 * LANES), aligned(8)));

// c -= a b' where TURNED, else c -= a b. Each number is a sum in the order of k, however many lanes there are.
template <bool TURNED>
static void subtract_product(const double *__restrict a, const double *__restrict b, double *__restrict c) {
    for (int64_t j = 0; j < TILE; j += WIDE)
        for (int64_t i = 0; i < TILE; i += LANES * HIGH) {
            Lanes sum[WIDE][HIGH];
            for (int64_t q = 0; q < WIDE; q++)
                for (int64_t r = 0; r < HIGH; r++)
                    sum[q][r] = *reinterpret_cast<const Lanes *>(c + (j + q) * TILE + i + r * LANES);
            for (int64_t k = 0; k < TILE; k++) {
                Lanes column[HIGH];
                for (int64_t r = 0; r < HIGH; r++)
                    column[r] = *reinterpret_cast<const Lanes *>(a + k * TILE + i + r * LANES);
                for (int64_t q = 0; q < WIDE; q++) {
                    const double factor = TURNED ? b[k * TILE + j + q] : b[(j + q) * TILE + k];
                    for (int64_t r = 0; r < HIGH; r++) sum[q][r] -= column[r] * factor;
                }
            }
            for (int64_t q = 0; q < WIDE; q++)
                for (int64_t r = 0; r < HIGH; r++)
                    *reinterpret_cast<Lanes *>(c + (j + q) * TILE + i + r * LANES) = sum[q][r];
        }
}

// Lower factor in the place of a diagonal tile, zeros above it; returns the row whose pivot is not positive, or TILE.
static int64_t factor_tile(double *a) {
    for (int64_t k = 0; k < TILE; k++) {
        double *own = a + k * TILE;
        if (!(own[k] > 0.0)) return k;
        const double pivot = sqrt(own[k]);
        for (int64_t i = 0; i < k; i++) own[i] = 0.0;
        for (int64_t i = k; i < TILE; i++) own[i] = own[i] / pivot;
        for (int64_t j = k + 1; j < TILE; j++) {
            double *other = a + j * TILE;
            const double factor = own[j];
            for (int64_t i = j; i < TILE; i++) other[i] -= own[i] * factor;
        }
    }
    return TILE;
}

// a = a l'^-1
static void divide_by_turned(const double *__restrict l, double *__restrict a) {
    for (int64_t k = 0; k < TILE; k++) {
        double *own = a + k * TILE;
        const double pivot = l[k * TILE + k];
        for (int64_t i = 0; i < TILE; i++) own[i] = own[i] / pivot;
        for (int64_t j = k + 1; j < TILE; j++) {
            const double factor = l[k * TILE + j];
            for (int64_t i = 0; i < TILE; i++) a[j * TILE + i] -= own[i] * factor;
        }
    }
}

// a = a l^-1
static void divide_by(const double *__restrict l, double *__restrict a) {
    for (int64_t k = TILE - 1; k >= 0; k--) {
        double *own = a + k * TILE;
        for (int64_t j = k + 1; j < TILE; j++) {
            const double factor = l[k * TILE + j];
            for (int64_t i = 0; i < TILE; i++) own[i] -= a[j * TILE + i] * factor;
        }
        const double pivot = l[k * TILE + k];
        for (int64_t i = 0; i < TILE; i++) own[i] = own[i] / pivot;
    }
}

static void turn(const double *__restrict a, double *__restrict turned) {
    for (int64_t j = 0; j < TILE; j++)
        for (int64_t i = 0; i < TILE; i++) turned[i * TILE + j] = a[j * TILE + i];
}

// Column `column` of the factor, in the place of the matrix, for rows of tiles from `low` to `high`; the columns before
// it are there. The diagonal tile comes first, in a call of its own. Returns -1, or the row whose pivot is not positive.
KERNEL int64_t factor_column(
    const Array *first, const Array *offset, const Array *tiles, int64_t column, int64_t low, int64_t high
) {
    const Envelope rows(first, offset, tiles);
    for (int64_t row = low; row < high; row++) {
        if (rows.first[row] > column) continue;
        double *own = rows.tile(row, column);
        for (int64_t k = larger(rows.first[row], rows.first[column]); k < column; k++)
            subtract_product<true>(rows.tile(row, k), rows.tile(column, k), own);
        if (row > column) {
            divide_by_turned(rows.tile(column, column), own);
        } else if (const int64_t at = factor_tile(own); at < TILE) {
            return row * TILE + at;
        }
    }
    return -1;
}

// Eight sums, whatever the width of the vectors: the same bytes from all of them.
static double product(const double *a, const double *b) {
    Lanes sums = {};
    for (int64_t k = 0; k < TILE; k += LANES)
        sums += *reinterpret_cast<const Lanes *>(a + k) * *reinterpret_cast<const Lanes *>(b + k);
    double sum = 0.0;
    for (int64_t k = 0; k < LANES; k++) sum += sums[k];
    return sum;
}

// Solutions in the place of right-hand sides (number, rows of the matrix).
KERNEL int64_t solve_factored(const Array *first, const Array *offset, const Array *tiles, const Array *right) {
    const Envelope rows(first, offset, tiles);
    const View<double, 2> sides(right);
    for (int64_t side = 0; side < sides.shape[0]; side++) {
        double *x = sides.row(side);
        for (int64_t row = 0; row < rows.count; row++) {
            double *own = x + row * TILE;
            for (int64_t column = rows.first[row]; column <= row; column++) {
                const double *a = rows.tile(row, column), *known = x + column * TILE;
                for (int64_t k = 0; k < TILE; k++) {
                    if (column == row) own[k] = own[k] / a[k * TILE + k];
                    const double factor = known[k];
                    for (int64_t i = column == row ? k + 1 : 0; i < TILE; i++) own[i] -= a[k * TILE + i] * factor;
                }
            }
        }
        for (int64_t row = rows.count - 1; row >= 0; row--) {
            const double *own = x + row * TILE;
            for (int64_t column = row; column >= rows.first[row]; column--) {
                const double *a = rows.tile(row, column);
                double *to = x + column * TILE;
                if (column < row) {
                    for (int64_t k = 0; k < TILE; k++) to[k] -= product(a + k * TILE, own);
                    continue;
                }
                for (int64_t k = TILE - 1; k >= 0; k--) {
                    for (int64_t i = k + 1; i < TILE; i++) to[k] -= a[k * TILE + i] * own[i];
                    to[k] = to[k] / a[k * TILE + k];
                }
            }
        }
    }
    return 0;
}

// Column of the inverse within the envelope (Takahashi), from the factor and from the columns behind it, which are
// there. `below` are the rows of tiles under the diagonal that have this column, `turned` room for a tile of each:
// first `prepare_column`, which fills it; then `invert_column`, for any part of the rows; then `invert_diagonal`.
KERNEL int64_t prepare_column(
    const Array *first, const Array *offset, const Array *factor, const Array *below, int64_t column, const Array *scaled
) {
    const Envelope rows(first, offset, factor);
    const View<int64_t, 1> under(below);
    double *to = static_cast<double *>(scaled->data);
    for (int64_t k = 0; k < under.shape[0]; k++, to += TILE * TILE) {
        const double *from = rows.tile(under(k), column);
        for (int64_t i = 0; i < TILE * TILE; i++) to[i] = from[i];
        divide_by(rows.tile(column, column), to);
    }
    return 0;
}

KERNEL int64_t invert_column(
    const Array *first, const Array *offset, const Array *inverse, const Array *below, int64_t column,
    const Array *scaled, int64_t low, int64_t high
) {
    const Envelope rows(first, offset, inverse);
    const View<int64_t, 1> under(below);
    double turned[TILE * TILE];
    for (int64_t k = low; k < high; k++) {
        double *own = rows.tile(under(k), column);
        for (int64_t i = 0; i < TILE * TILE; i++) own[i] = 0.0;
        const double *other = static_cast<const double *>(scaled->data);
        for (int64_t m = 0; m < under.shape[0]; m++, other += TILE * TILE) {
            const double *known = turned;
            if (m <= k)
                known = rows.tile(under(k), under(m));
            else
                turn(rows.tile(under(m), under(k)), turned);
            subtract_product<false>(known, other, own);
        }
    }
    return 0;
}

KERNEL int64_t invert_diagonal(
    const Array *first, const Array *offset, const Array *factor, const Array *inverse, const Array *below,
    int64_t column, const Array *scaled
) {
    const Envelope from(first, offset, factor), rows(first, offset, inverse);
    const View<int64_t, 1> under(below);
    double unit[TILE * TILE] = {}, turned[TILE * TILE];
    for (int64_t i = 0; i < TILE; i++) unit[i * TILE + i] = -1.0;
    divide_by(from.tile(column, column), unit);
    // With u = -l^-1 the inverse of l l' is u' u, which is what is left of -(-u') u.
    double *own = rows.tile(column, column);
    for (int64_t i = 0; i < TILE * TILE; i++) own[i] = 0.0;
    turn(unit, turned);
    for (int64_t i = 0; i < TILE * TILE; i++) turned[i] = -turned[i];
    subtract_product<false>(turned, unit, own);
    const double *other = static_cast<const double *>(scaled->data);
    for (int64_t k = 0; k < under.shape[0]; k++, other += TILE * TILE) {
        turn(other, turned);
        subtract_product<false>(turned, rows.tile(under(k), column), own);
    }
    // Both halves are the same to the last digit.
    for (int64_t j = 0; j < TILE; j++)
        for (int64_t i = 0; i < j; i++) own[j * TILE + i] = own[i * TILE + j];
    return 0;
}
