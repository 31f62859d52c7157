// Image pyramids of Burt and Adelson (1983), and differences of images from a base.

#include "blocks.hpp"

constexpr float SIXTEENTH = 0.0625f, EIGHTH = 0.125f, QUARTER = 0.25f, THREE_EIGHTHS = 0.375f;
constexpr float HALF = 0.5f, THREE_QUARTERS = 0.75f;

KERNEL int64_t reduce(const Array *fine, const Array *out) {
    const View<const float, 3> from(fine);
    const View<float, 3> to(out);
    const int64_t height = fine->shape[1], width = fine->shape[2];
    // Two samples before the line and two behind it repeat its ends.
    const Buffer<float> padded(width + 4);
    float *line = padded + 2;
    for (int64_t m = 0; m < out->shape[0]; m++)
        for (int64_t k = 0; k < out->shape[1]; k++) {
            const auto row = [&](int64_t by) {
                return &from(m, larger<int64_t>(0, smaller(2 * k + by, height - 1)), 0);
            };
            const float *a = row(-2), *b = row(-1), *c = row(0), *d = row(1), *e = row(2);
            for (int64_t i = 0; i < width; i++)
                line[i] = (a[i] + e[i]) * SIXTEENTH + (b[i] + d[i]) * QUARTER + c[i] * THREE_EIGHTHS;
            line[-2] = line[-1] = line[0];
            line[width] = line[width + 1] = line[width - 1];
            float *target = &to(m, k, 0);
            for (int64_t i = 0; i < width / 2; i++) {
                const float *p = line + 2 * i;
                target[i] = (p[-2] + p[2]) * SIXTEENTH + (p[-1] + p[1]) * QUARTER + p[0] * THREE_EIGHTHS;
            }
        }
    return 0;
}

KERNEL int64_t expand(const Array *coarse, const Array *out) {
    const View<const float, 3> from(coarse);
    const View<float, 3> to(out);
    const int64_t rows = coarse->shape[1], cols = coarse->shape[2];
    const Buffer<float> padded(cols + 2);
    float *line = padded + 1;
    for (int64_t m = 0; m < out->shape[0]; m++)
        for (int64_t r = 0; r < 2 * rows; r++) {
            const int64_t k = r / 2;
            const float *above = &from(m, larger<int64_t>(k - 1, 0), 0), *here = &from(m, k, 0);
            const float *below = &from(m, smaller(k + 1, rows - 1), 0);
            if (r % 2 == 0)
                for (int64_t i = 0; i < cols; i++) line[i] = (above[i] + below[i]) * EIGHTH + here[i] * THREE_QUARTERS;
            else
                for (int64_t i = 0; i < cols; i++) line[i] = (here[i] + below[i]) * HALF;
            line[-1] = line[0], line[cols] = line[cols - 1];
            float *target = &to(m, r, 0);
            for (int64_t i = 0; i < cols; i++) {
                target[2 * i] = (line[i - 1] + line[i + 1]) * EIGHTH + line[i] * THREE_QUARTERS;
                target[2 * i + 1] = (line[i] + line[i + 1]) * HALF;
            }
        }
    return 0;
}

template <class E>
static void subtract(
    const E *__restrict own, const E *__restrict base, const uint8_t *__restrict known, int64_t count,
    float *__restrict apart
) {
    for (int64_t c = 0; c < count; c++) apart[c] = known[c] ? static_cast<float>(own[c] - base[c]) : 0.0f;
}

KERNEL int64_t minus(const Array *values, const Array *ground, const Array *both, const Array *out) {
    if (!without_gaps(both)) return NO_FORM;
    const View<uint8_t, 2> known(both);
    const View<float, 3> apart(out);
    const int64_t cols = values->shape[1];
    return with_float(ground->type, [&]<class E>() {
        const Buffer<E> own(cols), base(cols);
        for (int64_t k = 0; k < values->shape[0]; k++)
            for (int64_t m = 0; m < values->shape[2]; m++) {
                load<E>(values, k, m, 0, cols, own);
                load<E>(ground, k, m, 0, cols, base);
                subtract<E>(own, base, known.row(k), cols, &apart(m, k, 0));
            }
        return 0;
    });
}

template <class E>
static void correct(
    const float *__restrict blend, const float *__restrict own, int64_t count, E *__restrict line
) {
    if (blend != nullptr)
        for (int64_t c = 0; c < count; c++) line[c] = blend[c] + line[c];
    if (own != nullptr)
        for (int64_t c = 0; c < count; c++) line[c] = line[c] - own[c];
}

KERNEL int64_t join(
    const Array *values, const Array *own, int64_t differs, const Array *blend, int64_t blends, const Array *label,
    int64_t index, double low, double high, int64_t whole, const Array *out
) {
    if (own->stride[2] != 1 || blend->stride[2] != 1 || !without_gaps(label)) return NO_FORM;
    const View<const float, 3> difference(own), correction(blend);
    const Range range{low, high, whole != 0};
    uint8_t chosen[RUN];
    // Every step is rounded to the type that holds the samples exactly.
    const bool narrow = values->type < U32 || values->type == F32;
    return with_float(narrow ? F32 : F64, [&]<class E>() {
        E line[RUN];
        for (int64_t k = 0; k < values->shape[0]; k++)
            for (int64_t first = 0; first < values->shape[1]; first += RUN) {
                const int64_t count = smaller(RUN, values->shape[1] - first);
                const int64_t number = find(label, index, k, first, count, chosen);
                for (int64_t m = 0; number && m < values->shape[2]; m++) {
                    load<E>(values, k, m, first, count, line);
                    const float *more = blends ? &correction(m, k, first) : nullptr;
                    const float *less = differs ? &difference(m, k, first) : nullptr;
                    correct(more, less, count, line);
                    store<E>(line, number == count ? nullptr : chosen, count, range, out, k, m, first);
                }
            }
        return 0;
    });
}
