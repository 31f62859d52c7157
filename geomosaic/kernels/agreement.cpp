// Agreement of two images of the same ground, see agreement.py.

#include "blocks.hpp"

constexpr int64_t SAMPLE = 4;

template <class T>
static double quad(const T *corner, const int64_t *stride) {
    const T *below = corner + stride[0];
    return static_cast<double>(corner[0]) + corner[stride[1]] + below[0] + below[stride[1]];
}

KERNEL int64_t compare(
    const Array *a, const Array *b, const Array *seen_a, const Array *seen_b, const Array *level, const Array *cells,
    int64_t first_row, int64_t first_col, const Array *out, const Array *known
) {
    if (a->type != b->type || !without_gaps(seen_a, seen_b)) return NO_FORM;
    const View<uint8_t, 2> one_seen(seen_a), other_seen(seen_b);
    const View<double, 1> levels(level);
    const View<float, 4> moments(out);
    const View<float, 2> is_known(known);
    const int64_t bands = a->shape[2], width = a->shape[1] / SAMPLE * SAMPLE;
    const auto whole = [&](int64_t top, int64_t left) {
        for (int64_t k = top; k < top + SAMPLE; k++) {
            const uint8_t *one = one_seen.row(k) + left, *other = other_seen.row(k) + left;
            for (int64_t i = 0; i < SAMPLE; i++)
                if (!one[i] || !other[i]) return false;
        }
        return true;
    };
    return with_float(a->type, [&]<class T>() {
        const View<const T, 3> first(a), second(b);
        return each_run(cells, a->shape[0] / SAMPLE * SAMPLE, width, [&](int64_t top, int64_t start, int64_t count) {
            if (top % SAMPLE) return 0;
            for (int64_t left = start; left < start + count; left += SAMPLE) {
                if (!whole(top, left)) continue;
                const int64_t r = top / SAMPLE - first_row, c = left / SAMPLE - first_col;
                is_known(r, c) = 1.0f;
                for (int64_t m = 0; m < bands; m++) {
                    double d = 0.0, s = 0.0, dd = 0.0, ds = 0.0, ss = 0.0;
                    for (int64_t k = top; k < top + SAMPLE; k += 2)
                        for (int64_t i = left; i < left + SAMPLE; i += 2) {
                            const double one = quad(&first(k, i, m), first.stride);
                            const double other = quad(&second(k, i, m), second.stride);
                            const double apart = (one - other) * 0.25, mean = (one + other) * 0.125 - levels(m);
                            d += apart, s += mean;
                            dd += apart * apart, ds += apart * mean, ss += mean * mean;
                        }
                    const double sums[] = {d, s, dd, ds, ss};
                    for (int n = 0; n < 5; n++) moments(n, m, r, c) = static_cast<float>(sums[n] * 0.25);
                }
            }
            return 0;
        });
    });
}

KERNEL int64_t deghost(
    const Array *a, const Array *b, const Array *seen_a, const Array *seen_b, const Array *weight_a,
    const Array *weight_b, int64_t factor, int64_t margin, int64_t index_a, int64_t index_b, const Array *cells,
    int64_t first_row, int64_t first_col, const Array *share, const Array *mean, const Array *slope,
    const Array *level, const Array *label, const Array *total
) {
    if (a->type != b->type || a->type != total->type || !without_gaps(seen_a, seen_b, label)) return NO_FORM;
    const View<uint8_t, 2> one_seen(seen_a), other_seen(seen_b);
    const View<const float, 2> weights_a(weight_a), weights_b(weight_b);
    const View<const double, 2> shares(share);
    const View<const double, 3> means(mean);
    const View<double, 1> slopes(slope), levels(level);
    const int64_t width = a->shape[1];
    const Buffer<Place<double>> along(width);
    const Buffer<Place<float>> along_weights(width);
    for (int64_t c = 0; c < width; c++) {
        along[c] = kept_within((c + 0.5) / SAMPLE - 0.5 - first_col, shares.shape[1]);
        along_weights[c] = among_weights(c, factor, margin);
    }
    uint8_t is_first[RUN], is_second[RUN];
    return with_float(a->type, [&]<class T>() {
        const View<const T, 3> one(a), other(b);
        const View<T, 3> sum(total);
        return each_run(cells, a->shape[0], width, [&](int64_t k, int64_t start, int64_t count) -> int64_t {
            const int64_t number = find(label, index_a, k, start, count, is_first);
            if (number + find(label, index_b, k, start, count, is_second) == 0) return 0;
            const uint8_t *in_one = one_seen.row(k), *in_other = other_seen.row(k);
            const auto v = kept_within((k + 0.5) / SAMPLE - 0.5 - first_row, shares.shape[0]);
            const auto down = among_weights(k, factor, margin);
            for (int64_t c = start; c < start + count; c++) {
                const bool first = is_first[c - start];
                if (!(first || is_second[c - start]) || !in_one[c] || !in_other[c]) continue;
                const Place<double> u = along[c];
                const double s = between(shares.data, shares.stride, v, u);
                if (s <= 0.0) continue;
                const auto &others = first ? weights_b : weights_a;
                const double w = between(others.data, others.stride, down, along_weights[c]);
                if (w <= 0.0) continue;
                for (int64_t m = 0; m < a->shape[2]; m++) {
                    const double x = one(k, c, m), y = other(k, c, m), own = first ? x : y;
                    const double half = first ? slopes(m) * 0.5 : -slopes(m) * 0.5;
                    const double usual = between(means.row(m), means.stride + 1, v, u);
                    const double expected = (usual + slopes(m) * (own - levels(m))) / (1.0 + half);
                    const double off = (x - y) - expected;
                    sum(k, c, m) = static_cast<T>(sum(k, c, m) + (w * s) * (first ? off : -off));
                }
            }
            return 0;
        });
    });
}
