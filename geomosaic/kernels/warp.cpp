// Blocks of output pixels filled from a window of an image, row by row: placed, sampled, corrected, rounded, stored.

#include "coordinates.hpp"
#include "sampling.hpp"

namespace {

// What happens to values before they are stored: value · gain + offset, rounded into the range of the output's type.
struct Ending {
    View<const double, 1> gain, offset;
    double low, high;
    bool whole;

    bool plain(int64_t bands) const {
        bool same = whole;
        for (int64_t m = 0; m < bands; m++) same &= gain(m) == 1.0 && offset(m) == 0.0;
        return same;
    }
};

// Where a window lies: its first column and row in the image, its reduction, and the image's size.
struct Place {
    double col0, row0, shrink, width, height;

    // Whether all that a row's pixels take lies in the window or beyond the image.
    bool holds(const Span &span, int64_t radius, int64_t rows, int64_t cols) const {
        const double reach = radius * shrink;
        const double first_col = larger(span.first_col - reach, 0.0), first_row = larger(span.first_row - reach, 0.0);
        const double last_col = smaller(span.last_col + reach, width - 1), last_row = smaller(span.last_row + reach, height - 1);
        return first_col >= col0 && first_row >= row0 && last_col < col0 + cols * shrink && last_row < row0 + rows * shrink;
    }
};

// Values of a row in units of Weights<W>::UNIT, `pixel` apart from pixel to pixel and `band` from band to band.
template <class W>
struct Values {
    const W *data;
    int64_t pixel, band;
    const uint8_t *kind;
    bool all;  // whether every pixel of the row is seen
};

// Rows of output pixels, written in the type and with the strides that they have.
class Output {
    const Array &out;
    const View<uint8_t, 2> valid;
    const Ending ending;
    const bool plain;
    // Gains and offsets again for each pixel of a row, so that rows of interleaved bands are one loop.
    Buffer<double> gains, offsets;

public:
    const int64_t rows, cols, bands;

    Output(const Array *values, const Array *validity, const Ending &ending)
        : out(*values), valid(validity), ending(ending), plain(ending.plain(out.shape[2])),
          gains(out.shape[1] * out.shape[2]), offsets(out.shape[1] * out.shape[2]), rows(out.shape[0]),
          cols(out.shape[1]), bands(out.shape[2]) {
        for (int64_t k = 0; k < cols * bands; k++) gains[k] = ending.gain(k % bands), offsets[k] = ending.offset(k % bands);
    }

    template <class W>
    void put(int64_t row, int64_t first, int64_t number, const Values<W> &values) const {
        with_type(out.type, [&]<class U>() -> int64_t {
            put_as(static_cast<U *>(out.data) + row * out.stride[0] + first * out.stride[1], number, values);
            return 0;
        });
        mark(values.kind, number, valid.row(row) + first);
    }

private:
    static void mark(const uint8_t *__restrict kind, int64_t number, uint8_t *__restrict seen) {
        for (int64_t c = 0; c < number; c++) seen[c] |= kind[c] != UNSEEN;
    }

    template <class U, class W>
    void put_as(U *target, int64_t number, const Values<W> &values) const {
        const int64_t pixel = out.stride[1], band = out.stride[2], from_pixel = values.pixel, count = bands;
        const W *const from = values.data;
        if (values.all && from_pixel == count && pixel == count && (count == 1 || band == 1)) {
            put_line(from, gains, offsets, number * count, target);
        } else if (values.all && from_pixel == 1 && pixel == 1) {
            for (int64_t m = 0; m < count; m++) put_band(from + m * values.band, m, number, target + m * band);
        } else {
            for (int64_t c = 0; c < number; c++) {
                if (values.kind[c] == UNSEEN) continue;
                for (int64_t m = 0; m < count; m++)
                    put_band(from + c * from_pixel + m * values.band, m, 1, target + c * pixel + m * band);
            }
        }
    }

    template <class U, class W>
    void put_band(const W *values, int64_t band, int64_t number, U *target) const {
        put_line(values, gains + band, offsets + band, number, target);
    }

    // Each value with its own gain and offset.
    template <class U, class W>
    void put_line(
        const W *__restrict values, const double *__restrict gain, const double *__restrict offset, int64_t number,
        U *__restrict target
    ) const {
        const double low = ending.low, high = ending.high;
        if constexpr (sizeof(W) == 4)
            if (plain) {  // in whole numbers; a range beyond 32 bits holds all that samples of eight bits give
                const int32_t least = static_cast<int32_t>(larger(low, -2147483648.0));
                const int32_t most = static_cast<int32_t>(smaller(high, 2147483647.0));
                for (int64_t k = 0; k < number; k++)
                    target[k] = as<U>(smaller(larger((values[k] + 2097152) >> 22, least), most));
                return;
            }
        if (ending.whole)
            for (int64_t k = 0; k < number; k++)
                target[k] = as<U>(rounded(values[k] * Weights<W>::UNIT * gain[k] + offset[k], low, high));
        else
            for (int64_t k = 0; k < number; k++)
                target[k] = static_cast<U>(values[k] * Weights<W>::UNIT * gain[k] + offset[k]);
    }
};

// First column of the first of a row's cells that are wanted, and where the last of them stops.
void wanted_columns(const uint8_t *need, int64_t cells, int64_t width, int64_t &first, int64_t &stop) {
    first = 0, stop = 0;
    for (int64_t cell = 0; cell < cells; cell++)
        if (need[cell]) first = stop ? first : cell, stop = cell + 1;
    first *= CELL, stop = smaller(stop * CELL, width);
}

template <class T, class W, int64_t METHOD>
int64_t fill(
    const Geometry &geometry, int64_t start, int64_t n, const View<uint8_t, 2> &need, const Window<T> &window,
    const Place &place, const Output &out
) {
    constexpr int64_t radius = METHOD == LANCZOS ? 3 : METHOD == CUBIC ? 2 : 1;
    const int64_t bands = window.bands, wide = out.cols * n;
    const double inverse = 1.0 / place.shrink;  // exact: a power of two
    const Rows placed(geometry, n, wide);
    Sampler<T, W, METHOD> sampler(window, wide);
    Buffer<double> cols(wide), rows(wide);
    const bool planar = window.planar();
    const int64_t pixel = planar || bands == 1 ? 1 : bands, band = planar ? wide : 1;
    if (n == 1) {
        for (int64_t k = start; k < out.rows; k++) {
            int64_t first, stop;
            wanted_columns(need.row(k / CELL), need.shape[1], wide, first, stop);
            if (first == stop) continue;
            placed.place((k + 0.5) / geometry.step, need.row(k / CELL), cols, rows);
            Span span;
            span.widen(cols + first, rows + first, stop - first, place.width, place.height);
            if (span.last_col < 0) continue;
            if (!place.holds(span, radius, window.height, window.width)) return k;
            const int64_t number = stop - first;
            sampler.take(
                cols + first, rows + first, number, place.width, place.height, place.col0, place.row0, inverse
            );
            if (sampler.seen)
                out.put(k, first, number, Values<W>{sampler.values, pixel, band, sampler.kind, sampler.seen == number});
        }
        return out.rows;
    }
    // Means of n × n samples, where at least half of them are seen.
    Buffer<double> totals(out.cols * bands);
    Buffer<int32_t> counts(out.cols);
    Buffer<uint8_t> kind(out.cols);
    for (int64_t k = start; k < out.rows; k++) {
        for (int64_t c = 0; c < out.cols; c++) counts[c] = 0;
        for (int64_t c = 0; c < out.cols * bands; c++) totals[c] = 0.0;
        for (int64_t q = 0; q < n; q++) {
            placed.place((k + (q + 0.5) / n) / geometry.step, need.row(k / CELL), cols, rows);
            Span span;
            span.widen(cols, rows, wide, place.width, place.height);
            if (span.last_col < 0) continue;
            if (!place.holds(span, radius, window.height, window.width)) return k;
            sampler.take(cols, rows, wide, place.width, place.height, place.col0, place.row0, inverse);
            for (int64_t c = 0; c < out.cols; c++)
                for (int64_t p = c * n; p < c * n + n; p++) {
                    if (sampler.kind[p] == UNSEEN) continue;
                    for (int64_t m = 0; m < bands; m++)
                        totals[c * bands + m] += sampler.values[p * pixel + m * band] * Weights<W>::UNIT;
                    counts[c]++;
                }
        }
        int64_t seen = 0;
        for (int64_t c = 0; c < out.cols; c++) {
            kind[c] = 2 * counts[c] >= n * n ? FULL : UNSEEN;
            seen += kind[c] == FULL;
            if (kind[c])
                for (int64_t m = 0; m < bands; m++) totals[c * bands + m] /= counts[c];
        }
        out.put(k, 0, out.cols, Values<double>{totals, bands, 1, kind, seen == out.cols});
    }
    return out.rows;
}

// Call a generic lambda with the types of samples and of their sums, and the method.
template <class Form>
int64_t with_method(int64_t type, int64_t method, bool masked, Form form) {
    return with_type(type, [&]<class T>() -> int64_t {
        // Means over the valid ones of four pixels are no whole numbers of 2048ths.
        constexpr bool eight_bits = sizeof(T) == 1;
        switch (method) {
            case NEAREST: return form.template operator()<T, double, NEAREST>();
            case BILINEAR:
                if constexpr (eight_bits)
                    if (!masked) return form.template operator()<T, int32_t, BILINEAR>();
                return form.template operator()<T, double, BILINEAR>();
            case CUBIC:
                if constexpr (eight_bits)
                    if (!masked) return form.template operator()<T, int32_t, CUBIC>();
                return form.template operator()<T, double, CUBIC>();
            case LANCZOS: return form.template operator()<T, double, LANCZOS>();
            default: return NO_FORM;
        }
    });
}

}  // namespace

#define IMAGE                                                                                              \
    const Array *source, const Array *validity, int64_t masked, double col0, double row0, double shrink, double width, \
        double height, int64_t method
#define ENDING \
    const Array *gain, const Array *offset, double low, double high, int64_t whole, const Array *values, const Array *valid
#define ENDING_OF Ending{gain, offset, low, high, whole != 0}

// Rows of a block from `start` on; returns the first that reaches beyond the window, or the block's height.
KERNEL int64_t warp(GEOMETRY, int64_t start, int64_t n, const Array *need, IMAGE, ENDING) {
    if (!without_gaps(need, validity, valid)) return NO_FORM;
    const Geometry geometry = GEOMETRY_OF;
    const Place place{col0, row0, shrink, width, height};
    const Output out(values, valid, ENDING_OF);
    return with_method(source->type, method, masked != 0, [&]<class T, class W, int64_t METHOD>() -> int64_t {
        const Window<T> window(source, validity, masked != 0);
        return fill<T, W, METHOD>(geometry, start, n, need, window, place, out);
    });
}

// Rows of pixels with given image coordinates.
KERNEL int64_t sample(const Array *cols, const Array *rows, IMAGE, ENDING) {
    if (!without_gaps(cols, rows, validity, valid)) return NO_FORM;
    const View<double, 2> x(cols), y(rows);
    const Output out(values, valid, ENDING_OF);
    return with_method(source->type, method, masked != 0, [&]<class T, class W, int64_t METHOD>() -> int64_t {
        const Window<T> window(source, validity, masked != 0);
        Sampler<T, W, METHOD> sampler(window, out.cols);
        const bool planar = window.planar();
        const int64_t pixel = planar || window.bands == 1 ? 1 : window.bands, band = planar ? out.cols : 1;
        for (int64_t k = 0; k < out.rows; k++) {
            sampler.take(x.row(k), y.row(k), out.cols, width, height, col0, row0, 1.0 / shrink);
            if (sampler.seen)
                out.put(k, 0, out.cols, Values<W>{sampler.values, pixel, band, sampler.kind, sampler.seen == out.cols});
        }
        return 0;
    });
}
