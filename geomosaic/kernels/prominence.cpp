// Prominence of summits, by union-find over nodes in order of descending height; `relief/spot_heights.py` says of what.

#include "array.hpp"

static int64_t root(int64_t *parents, int64_t node) {
    // Path halving keeps the trees flat.
    while (parents[node] != node) {
        parents[node] = parents[parents[node]];
        node = parents[node];
    }
    return node;
}

// `order` are the known nodes, highest first; `found` is 0 at first.
KERNEL int64_t prominences(const Array *heights, const Array *order, int64_t rows, int64_t cols, const Array *found) {
    const View<double, 1> z(heights), prominence(found);
    const View<int64_t, 1> nodes(order);
    const int64_t number = nodes.shape[0];
    const Buffer<int64_t> parents(rows * cols), rank(rows * cols);
    for (int64_t node = 0; node < rows * cols; node++) parents[node] = -1;
    for (int64_t k = 0; k < number; k++) {
        const int64_t node = nodes(k), row = node / cols, col = node % cols;
        rank[node] = k;
        parents[node] = node;
        int64_t best = node;
        for (int64_t i = larger<int64_t>(row - 1, 0); i < smaller(row + 2, rows); i++)
            for (int64_t j = larger<int64_t>(col - 1, 0); j < smaller(col + 2, cols); j++) {
                const int64_t other = i * cols + j;
                if (other == node || parents[other] < 0) continue;
                const int64_t top = root(parents, other);
                if (best == node) {
                    best = top;
                } else if (top != best) {
                    const bool joins = rank[top] > rank[best];
                    const int64_t low = joins ? top : best, high = joins ? best : top;
                    prominence(low) = z(low) - z(node);
                    parents[low] = high;
                    best = high;
                }
            }
        parents[node] = best;
    }
    // Summits that joined no higher one keep their whole height above the lowest node of their component.
    for (int64_t k = number - 1; k >= 0; k--) {
        const int64_t top = root(parents, nodes(k));
        if (prominence(top) == 0.0) prominence(top) = z(top) - z(nodes(k));
    }
    return 0;
}
