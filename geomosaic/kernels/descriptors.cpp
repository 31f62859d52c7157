// Nearest descriptors of two images' features; `matching/descriptors.py` says of what.

#include "array.hpp"

constexpr int64_t LENGTH = 128;

// The nearest and the second nearest of some descriptors, by squared distance.
struct Nearest {
    int64_t *index;
    int32_t *first, *second;

    void take(int64_t at, int64_t other, int32_t distance) const {
        if (distance < first[at]) second[at] = first[at], first[at] = distance, index[at] = other;
        else if (distance < second[at]) second[at] = distance;
    }
};

// Squared distance of two descriptors.
static inline int32_t apart(const uint8_t *a, const uint8_t *b) {
    int32_t sum = 0;
    for (int64_t k = 0; k < LENGTH; k++) {
        const int32_t off = int32_t(a[k]) - int32_t(b[k]);
        sum += off * off;
    }
    return sum;
}

// Candidates of a feature are the features of the other image within `reach` of where it is expected, and within `band`
// of a line there (a, b, c with a² + b² = 1: a·x + b·y + c = 0). They stand in cells of `reach` pixels, sorted by cell:
// from start[cell] to start[cell + 1], `cols` cells in a row. All distances that are computed serve both images.
KERNEL int64_t nearest_descriptors(
    const Array *first, const Array *second, const Array *expected, const Array *lines, const Array *places,
    const Array *start, int64_t cols, int64_t rows, double reach, double band, const Array *index_of_first,
    const Array *distances_of_first, const Array *index_of_second, const Array *distances_of_second
) {
    const View<uint8_t, 2> one(first), other(second);
    const View<double, 2> place(places), where(expected), line(lines);
    const View<int64_t, 1> begin(start);
    const View<int32_t, 2> to_second(distances_of_first), to_first(distances_of_second);
    const Nearest of_first{static_cast<int64_t *>(index_of_first->data), to_second.row(0), to_second.row(1)};
    const Nearest of_second{static_cast<int64_t *>(index_of_second->data), to_first.row(0), to_first.row(1)};
    for (int64_t n = 0; n < one.shape[0]; n++) {
        const double x = where(n, 0), y = where(n, 1), a = line(n, 0), b = line(n, 1), c = line(n, 2);
        if (!(x == x && y == y)) continue;
        const double col = floor(x / reach), row = floor(y / reach);
        const int64_t left = col < 1.0 ? 0 : col - 1.0 < cols ? int64_t(col) - 1 : cols;
        const int64_t right = col < -1.0 ? 0 : col + 2.0 < cols ? int64_t(col) + 2 : cols;
        const int64_t above = row < 1.0 ? 0 : row - 1.0 < rows ? int64_t(row) - 1 : rows;
        const int64_t below = row < -1.0 ? 0 : row + 2.0 < rows ? int64_t(row) + 2 : rows;
        for (int64_t j = above; j < below; j++) {
            if (left >= right) break;
            for (int64_t m = begin(j * cols + left); m < begin(j * cols + right); m++) {
                const double u = place(m, 0), v = place(m, 1);
                const double off = a * u + b * v + c;
                if (off > band || off < -band) continue;
                if ((u - x) * (u - x) + (v - y) * (v - y) > reach * reach) continue;
                const int32_t distance = apart(one.row(n), other.row(m));
                of_first.take(n, m, distance);
                of_second.take(m, n, distance);
            }
        }
    }
    return 0;
}
