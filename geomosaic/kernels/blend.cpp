// Weighted means of several images, and corrections of values by table or by gains on a coarse net.
//
// Arrays of samples are (rows, cols, bands) in any interleaving and are worked through band by band within a row.

#include "blocks.hpp"

// Weights of a run of pixels, 0 where the image is not seen, between two rows of nodes.
static void weigh(
    const float *__restrict upper, const float *__restrict lower, float down, const int32_t *__restrict node,
    const float *__restrict part, const uint8_t *__restrict seen, int64_t count, float *__restrict weight
) {
    for (int64_t c = 0; c < count; c++) {
        const int32_t i = node[c];
        const float top = upper[i] + (upper[i + 1] - upper[i]) * part[c];
        const float low = lower[i] + (lower[i + 1] - lower[i]) * part[c];
        const float found = top + (low - top) * down;
        weight[c] = ((seen[c] != 0) & (found > 0.0f)) ? found : 0.0f;
    }
}

template <class L>
static void choose(
    const float *__restrict weight, int64_t count, L index, float *__restrict sum, float *__restrict best,
    L *__restrict label
) {
    for (int64_t c = 0; c < count; c++) {
        const float now = weight[c], before = best[c];
        const L other = label[c];
        sum[c] += now;
        best[c] = now > before ? now : before, label[c] = now > before ? index : other;
    }
}

// Chosen, not multiplied by zero: what stands where nothing is known may be no number.
template <class T, class From, class To>
static void add(
    const float *__restrict weight, int64_t count, const T *__restrict values, From along, T *__restrict total, To step
) {
    for (int64_t c = 0; c < count; c++) {
        const T before = total[c * step], sum = before + weight[c] * values[c * along];
        total[c * step] = weight[c] > 0.0f ? sum : before;
    }
}

KERNEL int64_t accumulate(
    const Array *values, const Array *valid, const Array *weight, int64_t factor, int64_t margin, int64_t index,
    const Array *cells, const Array *total, const Array *sums, const Array *best, const Array *label
) {
    if (values->type != total->type || !without_gaps(valid, weight, sums, best, label)) return NO_FORM;
    const View<float, 2> nodes(weight), sum(sums), most(best);
    const View<uint8_t, 2> seen(valid);
    const int64_t height = values->shape[0], width = values->shape[1], bands = values->shape[2];
    const Buffer<int32_t> node(width);
    const Buffer<float> part(width);
    for (int64_t c = 0; c < width; c++) {
        const Place<float> place = among_weights(c, factor, margin);
        node[c] = place.node, part[c] = place.part;
    }
    return each_run(cells, height, width, [&](int64_t k, int64_t first, int64_t count) {
        float w[RUN];
        const Place<float> down = among_weights(k, factor, margin);
        const float *upper = nodes.row(down.node), *lower = nodes.row(down.node + 1);
        weigh(upper, lower, down.part, node + first, part + first, seen.row(k) + first, count, w);
        with_type(label->type, [&]<class L>() {
            L *number = View<L, 2>(label).row(k) + first;
            choose(w, count, static_cast<L>(index), sum.row(k) + first, most.row(k) + first, number);
            return 0;
        });
        return with_float(total->type, [&]<class T>() {
            for (int64_t m = 0; m < bands; m++) {
                const Line<const T> from(values, k, m, first);
                const Line<T> to(total, k, m, first);
                if (from.stride == to.stride)
                    with_stride(to.stride, [&](auto stride) { add(w, count, from.data, stride, to.data, stride); });
                else
                    add(w, count, from.data, from.stride, to.data, to.stride);
            }
            return 0;
        });
    });
}

static void invert(const float *__restrict sum, int64_t count, float *__restrict share, uint8_t *__restrict known) {
    for (int64_t c = 0; c < count; c++) known[c] = sum[c] > 0.0f, share[c] = 1.0f / sum[c];
}

template <class T, class Stride>
static void divide(
    const T *__restrict total, Stride stride, const float *__restrict share, int64_t count, double *__restrict line
) {
    for (int64_t c = 0; c < count; c++) line[c] = total[c * stride] * share[c];
}

KERNEL int64_t finish(
    const Array *total, const Array *sums, const Array *cells, double low, double high, int64_t whole,
    const Array *out, const Array *out_valid
) {
    if (!without_gaps(sums, out_valid)) return NO_FORM;
    const View<float, 2> sum(sums);
    const View<uint8_t, 2> valid(out_valid);
    const Range range{low, high, whole != 0};
    return each_run(cells, out->shape[0], out->shape[1], [&](int64_t k, int64_t first, int64_t count) -> int64_t {
        float share[RUN];
        uint8_t known[RUN];
        double line[RUN];
        invert(sum.row(k) + first, count, share, known);
        const int64_t number = mark(known, count, valid.row(k) + first);
        if (number == 0) return 0;
        return with_float(total->type, [&]<class T>() {
            for (int64_t m = 0; m < out->shape[2]; m++) {
                const Line<const T> from(total, k, m, first);
                with_stride(from.stride, [&](auto stride) { divide(from.data, stride, share, count, line); });
                store<double>(line, number == count ? nullptr : known, count, range, out, k, m, first);
            }
            return 0;
        });
    });
}

template <class V, class T>
static void look_up(
    const V *__restrict values, int64_t along, const T *__restrict table, const uint8_t *__restrict chosen,
    int64_t count, T *__restrict to, int64_t step
) {
    if (chosen == nullptr)
        for (int64_t c = 0; c < count; c++) to[c * step] = table[values[c * along]];
    else
        for (int64_t c = 0; c < count; c++)
            if (chosen[c]) to[c * step] = table[values[c * along]];
}

KERNEL int64_t lookup(
    const Array *values, const Array *table, const Array *wanted, int64_t choose, const Array *out,
    const Array *out_valid
) {
    if (table->type != out->type || !without_gaps(table, wanted, out_valid)) return NO_FORM;
    const int64_t cols = values->shape[1];
    const auto in_types = [&]<class V, class T>() {
        for (int64_t k = 0; k < values->shape[0]; k++) {
            const uint8_t *chosen = choose ? View<uint8_t, 2>(wanted).row(k) : nullptr;
            // Band by band: a third of the time of pixel by pixel, since the inner loops are long.
            for (int64_t m = 0; m < values->shape[2]; m++) {
                const Line<const V> from(values, k, m);
                const Line<T> to(out, k, m);
                look_up(from.data, from.stride, View<T, 2>(table).row(m), chosen, cols, to.data, to.stride);
            }
            uint8_t *valid = View<uint8_t, 2>(out_valid).row(k);
            if (choose)
                mark(chosen, cols, valid);
            else
                memset(valid, 1, cols);
        }
        return 0;
    };
    return with_type(out->type, [&]<class T>() -> int64_t {
        if (values->type == U8) return in_types.template operator()<uint8_t, T>();
        if (values->type == U16) return in_types.template operator()<uint16_t, T>();
        return NO_FORM;
    });
}

// Values by a curve of which every step is known; NaN stays what it is.
static void bend(
    const double *__restrict curve, int64_t stride, int64_t steps, double scale, int64_t count, double *__restrict line
) {
    for (int64_t c = 0; c < count; c++) {
        const double at = larger(line[c] * scale, 0.0);
        const int32_t step = static_cast<int32_t>(at < steps ? at : steps - 1.0);
        const double first = curve[step * stride];
        line[c] = first + (curve[(step + 1) * stride] - first) * (at - step);
    }
}

// Values of a run of pixels between the nodes of a row.
static void interpolate(
    const double *__restrict nodes, const Place<double> *__restrict at, int64_t count, double *__restrict line
) {
    for (int64_t c = 0; c < count; c++) {
        const double *left = nodes + at[c].node;
        line[c] = left[0] + (left[1] - left[0]) * at[c].part;
    }
}

// One band of a row between the nodes' rows.
static void interpolate_row(const double *upper, const int64_t *stride, Place<double> v, int64_t count, double *row) {
    upper += v.node * stride[0];
    for (int64_t i = 0; i < count; i++, upper += stride[1]) row[i] = upper[0] + (upper[stride[0]] - upper[0]) * v.part;
}

KERNEL int64_t shade(
    const Array *values, const Array *seen, const Array *net, const Array *path, const Array *haze, double u0,
    double v0, double du, double dv, const Array *dark, const Array *curve, double reach, const Array *offset,
    double low, double high, int64_t whole, const Array *out, const Array *out_valid
) {
    if (!without_gaps(seen, out_valid)) return NO_FORM;
    const View<double, 3> gains(net);
    const View<double, 2> ways(path), curves(curve);
    const View<double, 1> hazes(haze), darks(dark), offsets(offset);
    const View<uint8_t, 2> shown(seen), valid(out_valid);
    const int64_t height = values->shape[0], width = values->shape[1], bands = values->shape[2];
    const int64_t nodes = net->shape[1], steps = curve->shape[1] - 1;
    const bool hazy = path->shape[0] > 0;
    const double scale = steps / reach;
    const Range range{low, high, whole != 0};

    const Buffer<Place<double>> along(width);
    for (int64_t c = 0; c < width; c++) along[c] = kept_within(u0 + c * du, nodes);
    // Gains of each band, and behind them paths, at the nodes of the net's columns.
    const Buffer<double> rows((bands + 1) * nodes);
    double line[RUN], gain[RUN], way[RUN];
    for (int64_t k = 0; k < height; k++) {
        const Place<double> v = kept_within(v0 + k * dv, net->shape[0]);
        for (int64_t m = 0; m < bands; m++)
            interpolate_row(&gains(0, 0, m), gains.stride, v, nodes, rows + m * nodes);
        if (hazy) interpolate_row(ways.data, ways.stride, v, nodes, rows + bands * nodes);
        for (int64_t first = 0; first < width; first += RUN) {
            const int64_t count = smaller(RUN, width - first);
            const uint8_t *chosen = shown.row(k) + first;
            const int64_t number = mark(chosen, count, valid.row(k) + first);
            if (number == 0) continue;
            if (hazy) interpolate(rows + bands * nodes, along + first, count, way);
            for (int64_t m = 0; m < bands; m++) {
                load<double>(values, k, m, first, count, line);
                for (int64_t c = 0; c < count; c++) line[c] += darks(m);
                if (hazy)
                    for (int64_t c = 0; c < count; c++) line[c] -= hazes(m) * way[c];
                if (steps > 0) bend(curves.row(m), curves.stride[1], steps, scale, count, line);
                interpolate(rows + m * nodes, along + first, count, gain);
                for (int64_t c = 0; c < count; c++) line[c] = gain[c] * line[c] + offsets(m);
                store<double>(line, number == count ? nullptr : chosen, count, range, out, k, m, first);
            }
        }
    }
    return 0;
}
