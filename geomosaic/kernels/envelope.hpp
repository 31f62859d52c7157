// Places of the tiles of a symmetric matrix within an envelope; see envelope.cpp.

#pragma once

#include "array.hpp"

// Rows and columns of a tile: three of them stay in the nearest cache. The same as `TILE` in estimation/envelope.py.
constexpr int64_t TILE = 32;

struct Envelope {
    const int64_t *first, *offset;
    double *tiles;
    int64_t count;

    Envelope(const Array *first, const Array *offset, const Array *tiles)
        : first(static_cast<const int64_t *>(first->data)),
          offset(static_cast<const int64_t *>(offset->data)),
          tiles(static_cast<double *>(tiles->data)),
          count(first->shape[0]) {}

    double *tile(int64_t row, int64_t column) const {
        return tiles + (offset[row] + column - first[row]) * (TILE * TILE);
    }

    // A number of the lower triangle.
    double &operator()(int64_t row, int64_t column) const {
        return tile(row / TILE, column / TILE)[column % TILE * TILE + row % TILE];
    }

    bool has(int64_t row, int64_t column) const { return column / TILE >= first[row / TILE]; }

    // A number of the lower triangle, 0 outside of the envelope.
    double known(int64_t row, int64_t column) const { return has(row, column) ? (*this)(row, column) : 0.0; }

    double symmetric(int64_t a, int64_t b) const { return a < b ? known(b, a) : known(a, b); }
};
