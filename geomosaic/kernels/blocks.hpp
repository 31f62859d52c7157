// Blocks of pixels: their wanted cells, rows of one band of any type and interleaving, and places on coarse lattices.

#pragma once

#include "array.hpp"

// Pixels of a row that are worked on at once: few enough for the nearest cache, enough for types to be looked up.
constexpr int64_t RUN = 4 * CELL;

// Call a lambda (row, first column, number of pixels) for the runs of wanted cells, until one answers other than 0.
template <class Run>
int64_t each_run(const Array *cells, int64_t height, int64_t width, const Run &run) {
    const View<uint8_t, 2> wanted(cells);
    for (int64_t p = 0; p < wanted.shape[0]; p++)
        for (int64_t q = 0, end; q < wanted.shape[1]; q = larger(end, q + 1)) {
            for (end = q; end < wanted.shape[1] && end - q < RUN / CELL && wanted(p, end);) end++;
            if (end == q) continue;
            const int64_t first = q * CELL, count = smaller(end * CELL, width) - first;
            for (int64_t k = p * CELL; k < smaller(p * CELL + CELL, height); k++)
                if (const int64_t answer = run(k, first, count)) return answer;
        }
    return 0;
}

// Samples of a band along a row, from a column on.
template <class T>
struct Line {
    T *data;
    int64_t stride;

    Line(const Array *array, int64_t row, int64_t band, int64_t first = 0)
        : data(static_cast<T *>(array->data) + row * array->stride[0] + first * array->stride[1] + band * array->stride[2]),
          stride(array->stride[1]) {}
};

// What values are brought into before they are stored: whole numbers from `low` to `high`, or what they are.
struct Range {
    double low, high;
    bool whole;
};

// A generic lambda called with a stride that the compiler knows where it is a usual one: 1 to 4.
template <int64_t N>
struct Known {
    constexpr operator int64_t() const { return N; }
};

template <class Form>
inline void with_stride(int64_t stride, const Form &form) {
    switch (stride) {
        case 1: return form(Known<1>());
        case 2: return form(Known<2>());
        case 3: return form(Known<3>());
        case 4: return form(Known<4>());
        default: return form(stride);
    }
}

// Loops stand in functions of their own, with values as arguments: for all the compiler knows, a byte that is written
// may be one of a variable that a lambda refers to, and such a loop is done sample by sample.

template <class T, class E, class Stride>
inline void read(const T *__restrict from, Stride stride, int64_t count, E *__restrict line) {
    for (int64_t c = 0; c < count; c++) line[c] = static_cast<E>(from[c * stride]);
}

template <class T, class E>
inline void convert(const E *__restrict line, int64_t count, E low, E high, bool whole, T *__restrict made) {
    if (whole)
        for (int64_t c = 0; c < count; c++) made[c] = as<T>(rounded(line[c], low, high));
    else
        for (int64_t c = 0; c < count; c++) made[c] = as<T>(line[c]);
}

template <class T, class Stride>
inline void spread(const T *__restrict made, int64_t count, T *__restrict to, Stride stride) {
    for (int64_t c = 0; c < count; c++) to[c * stride] = made[c];
}

template <class T, class Stride>
inline void spread_chosen(
    const T *__restrict made, const uint8_t *__restrict chosen, int64_t count, T *__restrict to, Stride stride
) {
    for (int64_t c = 0; c < count; c++) {
        const T now = made[c], before = to[c * stride];
        to[c * stride] = chosen[c] ? now : before;
    }
}

template <class T>
inline int64_t find_in(const T *__restrict numbers, T number, int64_t count, uint8_t *__restrict here) {
    int32_t found = 0;
    for (int64_t c = 0; c < count; c++) {
        const bool equal = numbers[c] == number;
        here[c] = equal, found += equal;
    }
    return found;
}

// Pixels that are seen, and marked as such; returns how many.
inline int64_t mark(const uint8_t *__restrict seen, int64_t count, uint8_t *__restrict valid) {
    int32_t found = 0;
    for (int64_t c = 0; c < count; c++) {
        const bool here = seen[c] != 0;
        valid[c] = here ? 1 : valid[c], found += here;
    }
    return found;
}

// A run of a band as numbers that are computed with.
template <class E>
void load(const Array *values, int64_t row, int64_t band, int64_t first, int64_t count, E *line) {
    with_type(values->type, [&]<class T>() {
        const Line<const T> from(values, row, band, first);
        with_stride(from.stride, [&](auto stride) { read(from.data, stride, count, line); });
        return 0;
    });
}

// Numbers put into a run of a band: into all of them, or those that are chosen.
template <class E>
void store(
    const E *line, const uint8_t *chosen, int64_t count, const Range &range, const Array *out, int64_t row,
    int64_t band, int64_t first
) {
    with_type(out->type, [&]<class T>() {
        // Converted first and spread then: only the former can be done for many samples at once.
        T made[RUN];
        convert(line, count, static_cast<E>(range.low), static_cast<E>(range.high), range.whole, made);
        const Line<T> to(out, row, band, first);
        with_stride(to.stride, [&](auto stride) {
            if (chosen == nullptr)
                spread(made, count, to.data, stride);
            else
                spread_chosen(made, chosen, count, to.data, stride);
        });
        return 0;
    });
}

// Where an image's number stands; returns how often.
inline int64_t find(const Array *label, int64_t index, int64_t row, int64_t first, int64_t count, uint8_t *here) {
    return with_type(label->type, [&]<class T>() {
        return find_in(View<const T, 2>(label).row(row) + first, static_cast<T>(index), count, here);
    });
}

// Place between two nodes of a lattice.
template <class F>
struct Place {
    int32_t node;
    F part;
};

// The nearest place that is not beyond the lattice.
inline Place<double> kept_within(double at, int64_t nodes) {
    at = smaller(larger(at, 0.0), nodes - 1.0);
    const int32_t node = smaller(static_cast<int32_t>(at), static_cast<int32_t>(nodes - 2));
    return {node, at - node};
}

// A pixel's place among weights of `factor` pixels, `margin` of which lie before the block.
inline Place<float> among_weights(int64_t pixel, int64_t factor, int64_t margin) {
    const double at = (pixel + 0.5) / factor - 0.5 + margin;
    const int32_t node = static_cast<int32_t>(at);
    return {node, static_cast<float>(at - node)};
}

// Bilinear value at a place down and a place along.
template <class F>
F between(const F *nodes, const int64_t *stride, Place<F> v, Place<F> u) {
    const F *upper = nodes + v.node * stride[0] + u.node * stride[1], *lower = upper + stride[0];
    const F top = upper[0] + (upper[stride[1]] - upper[0]) * u.part;
    const F low = lower[0] + (lower[stride[1]] - lower[0]) * u.part;
    return top + (low - top) * v.part;
}
