// Values at the image coordinates of a row of output pixels: nearest, bilinear, cubic convolution and Lanczos.
//
// Each method is written once; the compiler makes a form of it for every type of samples and the usual numbers of
// bands. Samples of eight bits are taken with weights of 2048ths in whole numbers: exact, and a fraction of the time of
// floating point. All others are computed in double precision.

#pragma once

#include "array.hpp"

enum Method : int64_t { NEAREST, BILINEAR, CUBIC, LANCZOS };
// How a pixel of a row is taken: not at all; by the method; bilinearly, since some of the method's pixels are missing.
enum Kind : uint8_t { UNSEEN, FULL, EDGE };

// Window of an image; strides count samples, from line to line, pixel to pixel and band to band.
template <class T>
struct Window {
    const T *data;
    int64_t height, width, bands, line, pixel, band;
    const uint8_t *valid;  // null where every pixel is valid
    int64_t valid_line;

    Window(const Array *source, const Array *validity, bool masked)
        : data(static_cast<const T *>(source->data)), height(source->shape[0]), width(source->shape[1]),
          bands(source->shape[2]), line(source->stride[0]), pixel(source->stride[1]), band(source->stride[2]),
          valid(masked ? static_cast<const uint8_t *>(validity->data) : nullptr), valid_line(validity->stride[0]) {}

    bool is_valid(int64_t row, int64_t col) const { return valid[row * valid_line + col] != 0; }
    bool planar() const { return pixel == 1 && bands > 1; }
    // One band of planar samples as a window of its own.
    Window of_band(int64_t number) const {
        Window one = *this;
        one.data += number * band, one.bands = 1;
        return one;
    }
};

// Arithmetic of weighted sums. Weights of bilinear interpolation and of cubic convolution are multiplied once across
// and once down.
template <class W>
struct Weights;

template <>
struct Weights<double> {
    static constexpr double ONE = 1.0, UNIT = 1.0;
    // In 2048ths where the samples have eight bits, so that both kinds of arithmetic give the same bytes.
    static double fraction(double t, bool coarse) { return coarse ? floor(t * 2048.0 + 0.5) / 2048.0 : t; }
};

template <>
struct Weights<int32_t> {
    static constexpr int32_t ONE = 2048;
    static constexpr double UNIT = 1.0 / 4194304.0;
    static int32_t fraction(double t, bool) { return static_cast<int32_t>(t * 2048.0 + 0.5); }
};

template <class W>
inline W between(W first, W second, W weight) {
    return first * Weights<W>::ONE + (second - first) * weight;
}

// Weights of Keys (1981), a = −0.5. In 2048ths the outer two are rounded, and the inner two keep even ground and a
// slope: each rounded for itself they would move a picture whose pixels all have the same t, by up to 0.0007 px.
inline void cubic_weights(double t, bool, int32_t *w) {
    w[0] = static_cast<int32_t>(((-0.5 * t + 1.0) * t - 0.5) * t * 2048.0 - 0.5);
    w[3] = static_cast<int32_t>((0.5 * t - 0.5) * t * t * 2048.0 - 0.5);
    w[2] = static_cast<int32_t>(t * 2048.0 + 0.5) + w[0] - 2 * w[3];
    w[1] = 2048 - w[0] - w[2] - w[3];
}

inline void cubic_weights(double t, bool coarse, double *w) {
    if (coarse) {
        int32_t whole[4];
        cubic_weights(t, true, whole);
        for (int p = 0; p < 4; p++) w[p] = whole[p] / 2048.0;
        return;
    }
    w[0] = ((-0.5 * t + 1.0) * t - 0.5) * t;
    w[1] = (1.5 * t - 2.5) * t * t + 1.0;
    w[2] = ((-1.5 * t + 2.0) * t + 0.5) * t;
    w[3] = (0.5 * t - 0.5) * t * t;
}

// Sine by its series, for |x| ≤ π / 2, to the last bits: libraries of C differ there between systems.
inline double sine(double x) {
    const double y = x * x;
    double sum = 1.0;
    for (int k = 21; k > 1; k -= 2) sum = 1.0 - sum * y / (k * (k - 1));
    return x * sum;
}

// Lanczos' weights, three lobes, with the least change that lets them keep polynomials of third degree.
//
// Cut off after three lobes the sinc does not keep a slope, even with weights that sum to one: where t is the same at
// every pixel, smooth pictures move by up to 0.02 px. Σ w qᵏ = sᵏ, k = 0 … 3, with q the taps and s the place, both
// from the middle of the six, moves none below a quarter of a cycle per pixel by more than 0.006 px, and amplitudes
// stay. Fourth degree (0.02 px) and slopes alone (0.012 px) are worse there.
inline void lanczos_weights(double t, double *w) {
    constexpr double PI = 3.14159265358979323846, HALF_ROOT = 0.86602540378443864676;
    // d = π (t + 2 − p): sin d is ± sin πt, and sin d / 3 follows from that of πt / 3 by the sums of angles.
    const double whole = sine(PI * smaller(t, 1.0 - t)), third = sine(PI * t / 3.0), cosine = sine(PI / 2 - PI * t / 3.0);
    // cos and sin of (2 − p) π / 3.
    constexpr double cos_of[] = {-0.5, 0.5, 1.0, 0.5, -0.5, -1.0};
    constexpr double sin_of[] = {HALF_ROOT, HALF_ROOT, 0.0, -HALF_ROOT, -HALF_ROOT, 0.0};
    const double s = t - 0.5;
    double r0 = 1.0, r1 = s, r2 = s * s, r3 = s * s * s;
    for (int p = 0; p < 6; p++) {
        const double d = PI * (t + 2.0 - p), q = p - 2.5;
        const double product = (p % 2 ? -whole : whole) * (third * cos_of[p] + cosine * sin_of[p]);
        w[p] = d == 0.0 ? 1.0 : 3.0 * product / (d * d);
        r0 -= w[p];
        r1 -= w[p] * q;
        r2 -= w[p] * q * q;
        r3 -= w[p] * q * q * q;
    }
    // Least squares over the six taps: Σ q² = 17.5, Σ q⁴ = 88.375, Σ q⁶ = 511.09375; even and odd powers fall apart.
    const double c0 = (88.375 * r0 - 17.5 * r2) / 224.0, c1 = (511.09375 * r1 - 88.375 * r3) / 1134.0;
    const double c2 = (6.0 * r2 - 17.5 * r0) / 224.0, c3 = (17.5 * r3 - 88.375 * r1) / 1134.0;
    for (int p = 0; p < 6; p++) {
        const double q = p - 2.5;
        w[p] += ((c3 * q + c2) * q + c1) * q + c0;
    }
}

// Bilinear value of one pixel, band by band; of the valid ones of its four pixels only, and beyond the window's edge
// its pixels are repeated.
template <class T, class W>
void bilinear_pixel(const Window<T> &window, double x, double y, W *values) {
    const int64_t i = static_cast<int64_t>(x + 0.5) - 1, j = static_cast<int64_t>(y + 0.5) - 1;
    const W a = Weights<W>::fraction(x - 0.5 - i, sizeof(T) == 1), b = Weights<W>::fraction(y - 0.5 - j, sizeof(T) == 1);
    const int64_t i0 = larger<int64_t>(i, 0), j0 = larger<int64_t>(j, 0);
    const int64_t i1 = smaller(i + 1, window.width - 1), j1 = smaller(j + 1, window.height - 1);
    const T *const taps[] = {
        window.data + j0 * window.line + i0 * window.pixel, window.data + j0 * window.line + i1 * window.pixel,
        window.data + j1 * window.line + i0 * window.pixel, window.data + j1 * window.line + i1 * window.pixel};
    bool known[] = {true, true, true, true};
    if (window.valid) {
        known[0] = window.is_valid(j0, i0), known[1] = window.is_valid(j0, i1);
        known[2] = window.is_valid(j1, i0), known[3] = window.is_valid(j1, i1);
    }
    if (!(known[0] && known[1] && known[2] && known[3])) {
        const W one = Weights<W>::ONE, all[] = {(one - a) * (one - b), a * (one - b), (one - a) * b, a * b};
        W total = 0;
        for (int k = 0; k < 4; k++) total += all[k] * known[k];
        for (int64_t m = 0; m < window.bands; m++) {
            W value = 0;
            for (int k = 0; k < 4; k++)
                if (known[k] && all[k] > 0) value += all[k] * static_cast<W>(taps[k][m * window.band]);
            values[m] = value / total;
        }
        return;
    }
    for (int64_t m = 0; m < window.bands; m++) {
        const int64_t at = m * window.band;
        const W top = between<W>(taps[0][at], taps[1][at], a), low = between<W>(taps[2][at], taps[3][at], a);
        values[m] = between<W>(top, low, b);
    }
}

constexpr bool is_common(auto) { return false; }
constexpr bool is_common(uint8_t) { return true; }
constexpr bool is_common(uint16_t) { return true; }
constexpr bool is_common(int16_t) { return true; }
constexpr bool is_common(float) { return true; }

// Pixels of a run, on average over a row, from which on runs are sooner.
constexpr int64_t LONG = 12;

// Row of output pixels taken from a window by one method.
//
// Where neighbours in the output are neighbours in the image, as when a map is brought to another CRS at about its own
// pixel size, a run of them is arithmetic on samples that follow each other, which becomes vector instructions;
// elsewhere every pixel is taken for itself. Both give the same bytes.
template <class T, class W, int64_t METHOD>
class Sampler {
    static constexpr int TAPS = METHOD == LANCZOS ? 6 : METHOD == CUBIC ? 4 : METHOD == BILINEAR ? 2 : 1;
    static constexpr bool COARSE = sizeof(T) == 1;
    static constexpr bool COMMON = METHOD != LANCZOS && is_common(T{});
    const Window<T> &window;
    int64_t capacity;
    Buffer<int64_t> at;            // first of the taps, in samples from the window's first
    Buffer<W> across, down, wide;  // weights, one row of them for each tap; the same again for each band of a run
    int64_t edges = 0;

public:
    Buffer<uint8_t> kind;
    // Values in units of Weights<W>::UNIT, band by band where the window is planar, otherwise pixel by pixel.
    Buffer<W> values;
    int64_t seen = 0;

    Sampler(const Window<T> &window, int64_t capacity)
        : window(window), capacity(capacity), at(capacity), across(TAPS * capacity), down(TAPS * capacity),
          wide(2 * TAPS * capacity * (window.planar() ? 1 : window.bands)), kind(capacity),
          values(capacity * window.bands) {}

    // Take `number` pixels; coordinates are those of the image, of which the window starts at (col0, row0) and has
    // been reduced by 1 / `inverse`.
    void take(
        const double *cols, const double *rows, int64_t number, double width, double height, double col0, double row0,
        double inverse
    ) {
        find_taps(cols, rows, number, width, height, col0, row0, inverse);
        // Where every pixel is left to `take_edges` a window may have fewer rows or columns than the method has taps.
        if (edges < seen) take_all(number);
        if (edges) take_edges(cols, rows, number, col0, row0, inverse);
    }

private:
    void take_all(int64_t number) {
        const int64_t bands = window.bands;
        if (window.planar()) {
            for (int64_t m = 0; m < bands; m++) take_bands<COMMON ? 1 : 0>(window.of_band(m), number, values + m * capacity);
        } else {
            // Forms for the numbers of bands that are common with these types; one for all the others.
            if constexpr (COMMON) {
                switch (bands) {
                    case 1: take_bands<1>(window, number, values); break;
                    case 3: take_bands<3>(window, number, values); break;
                    case 4: take_bands<4>(window, number, values); break;
                    default: take_bands<0>(window, number, values);
                }
            } else {
                take_bands<0>(window, number, values);
            }
        }
    }

    // Loops without branches where every pixel is valid. What they store to is known to them as `__restrict` only:
    // bytes might lie over anything, and nothing would stay in registers.
    void find_taps(
        const double *__restrict cols, const double *__restrict rows, int64_t number, double width, double height,
        double col0, double row0, double inverse
    ) {
        // Whole numbers of 32 bits are multiplied to 64 at once; those of 64 take three instructions.
        const int32_t line = window.line, pixel = window.pixel;
        const int64_t size = capacity;
        const int32_t last_i = larger<int64_t>(window.width - TAPS, 0), last_j = larger<int64_t>(window.height - TAPS, 0);
        const bool small = window.width < TAPS || window.height < TAPS;
        constexpr int32_t before = TAPS / 2 - 1;  // taps before the one that lies before the point
        int64_t *__restrict first = at;
        W *__restrict u = across, *__restrict v = down;
        uint8_t *__restrict kinds = kind;
        int64_t in_image = 0, with_all = 0;
        for (int64_t c = 0; c < number; c++) {
            const bool here = (cols[c] >= 0.0) & (rows[c] >= 0.0) & (cols[c] < width) & (rows[c] < height);
            const double x = here ? (cols[c] - col0) * inverse : 0.5, y = here ? (rows[c] - row0) * inverse : 0.5;
            in_image += here;
            if constexpr (METHOD == NEAREST) {
                first[c] = samples(static_cast<int32_t>(y), line) + samples(static_cast<int32_t>(x), pixel);
                kinds[c] = here ? FULL : UNSEEN;
            } else {
                const int32_t i = static_cast<int32_t>(x + 0.5) - 1, j = static_cast<int32_t>(y + 0.5) - 1;
                const int32_t first_i = smaller(larger(i - before, 0), last_i);
                const int32_t first_j = smaller(larger(j - before, 0), last_j);
                first[c] = samples(first_j, line) + samples(first_i, pixel);
                if constexpr (METHOD == BILINEAR) {
                    // Beyond the centres of the window's outer pixels the nearest has all the weight.
                    const W right = Weights<W>::fraction(x - 0.5 - i, COARSE), below = Weights<W>::fraction(y - 0.5 - j, COARSE);
                    u[c] = i == first_i ? right : i > first_i ? Weights<W>::ONE : W(0);
                    v[c] = j == first_j ? below : j > first_j ? Weights<W>::ONE : W(0);
                    kinds[c] = here ? FULL : UNSEEN;
                } else {
                    const bool all = here & (i - before == first_i) & (j - before == first_j) & !small;
                    kinds[c] = all ? FULL : here ? EDGE : UNSEEN;
                    with_all += all;
                    W w[TAPS], z[TAPS];
                    weights_at(x - 0.5 - i, w);
                    weights_at(y - 0.5 - j, z);
                    for (int p = 0; p < TAPS; p++) u[p * size + c] = w[p], v[p * size + c] = z[p];
                }
            }
        }
        seen = in_image;
        edges = METHOD == CUBIC || METHOD == LANCZOS ? in_image - with_all : 0;
        if (METHOD == BILINEAR && small) leave_to_edges(number);
        if (window.valid && seen) find_valid(cols, rows, number, col0, row0, inverse);
    }

    static int64_t samples(int32_t number, int32_t each) { return static_cast<int64_t>(number) * each; }

    static void weights_at(double t, W *weights) {
        if constexpr (METHOD == CUBIC)
            cubic_weights(t, COARSE, weights);
        else
            lanczos_weights(t, weights);
    }

    // A window of one row or column has no neighbours to be between.
    void leave_to_edges(int64_t number) {
        for (int64_t c = 0; c < number; c++) kind[c] = kind[c] ? EDGE : UNSEEN;
        edges = seen;
    }

    // Pixels of unknown value are not seen; where others of the taps are unknown the pixel is left to `take_edges`.
    void find_valid(const double *cols, const double *rows, int64_t number, double col0, double row0, double inverse) {
        for (int64_t c = 0; c < number; c++) {
            if (kind[c] == UNSEEN) continue;
            const double x = (cols[c] - col0) * inverse, y = (rows[c] - row0) * inverse;
            if (!window.is_valid(static_cast<int64_t>(y), static_cast<int64_t>(x))) {
                edges -= kind[c] == EDGE;
                seen -= 1;
                kind[c] = UNSEEN;
                continue;
            }
            if (METHOD == NEAREST || kind[c] == EDGE) continue;
            const int64_t first_col = static_cast<int64_t>(x + 0.5) - TAPS / 2;
            const int64_t first_row = static_cast<int64_t>(y + 0.5) - TAPS / 2;
            bool all = true;
            for (int64_t q = larger<int64_t>(first_row, 0); q < smaller(first_row + TAPS, window.height); q++)
                for (int64_t p = larger<int64_t>(first_col, 0); p < smaller(first_col + TAPS, window.width); p++)
                    all &= window.is_valid(q, p);
            if (!all) kind[c] = EDGE, edges += 1;
        }
    }

    void take_edges(const double *cols, const double *rows, int64_t number, double col0, double row0, double inverse) {
        Buffer<W> found(window.bands);
        const bool planar = window.planar();
        for (int64_t c = 0; c < number; c++) {
            if (kind[c] != EDGE) continue;
            bilinear_pixel<T, W>(window, (cols[c] - col0) * inverse, (rows[c] - row0) * inverse, found);
            for (int64_t m = 0; m < window.bands; m++)
                values[planar ? m * capacity + c : c * window.bands + m] = found[m];
        }
    }

    // B bands that lie side by side, or window.bands where B is 0.
    template <int B>
    void take_bands(const Window<T> &from, int64_t number, W *out) {
        const int64_t bands = B ? B : from.bands;
        if (METHOD == NEAREST || !in_runs(number, from.pixel, bands)) {
            take_singly<B>(from, number, bands, out);
            return;
        }
        for (int64_t start = 0; start < number;) {
            int64_t stop = start + 1;
            if (kind[start] != FULL) {
                start = stop;
                continue;
            }
            while (stop < number && at[stop] - at[stop - 1] == from.pixel && kind[stop] == FULL) stop++;
            take_run<B>(from, start, stop - start, bands, out + start * bands);
            start = stop;
        }
    }

    // Whether the row has few breaks between pixels that follow each other in the window.
    bool in_runs(int64_t number, int64_t pixel, int64_t bands) const {
        if (pixel != bands) return false;
        int64_t breaks = 0;
        for (int64_t c = 1; c < number; c++) breaks += at[c] - at[c - 1] != pixel;
        return breaks * LONG <= number;
    }

    template <int B>
    void take_singly(const Window<T> &from, int64_t number, int64_t bands, W *__restrict out) const {
        const T *__restrict const data = from.data;
        const int64_t line = from.line, pixel = from.pixel, band = B == 1 ? 1 : from.band, size = capacity;
        const int64_t *__restrict const first = at;
        const W *__restrict const u = across, *__restrict const v = down;
        const uint8_t *__restrict const kinds = kind;
        if constexpr (B == 1 && METHOD == CUBIC)
            if (pixel == 1) {
                take_together(from, number, out);
                return;
            }
        for (int64_t c = 0; c < number; c++) {
            const T *const pixels = data + first[c];
            W *const values = out + c * bands;
            if constexpr (METHOD == NEAREST) {
                for (int64_t m = 0; m < bands; m++) values[m] = static_cast<W>(pixels[m * band]);
            } else if constexpr (METHOD == BILINEAR) {
                const W a = u[c], b = v[c];
                for (int64_t m = 0; m < bands; m++) {
                    const T *const p = pixels + m * band;
                    const W top = between<W>(p[0], p[pixel], a), low = between<W>(p[line], p[line + pixel], a);
                    values[m] = between<W>(top, low, b);
                }
            } else {
                if (kinds[c] != FULL) continue;
                W w[TAPS], z[TAPS];
                for (int p = 0; p < TAPS; p++) w[p] = u[p * size + c], z[p] = v[p * size + c];
                if constexpr (B > 1) {  // bands side by side are one vector
                    W totals[B] = {};
                    for (int q = 0; q < TAPS; q++) {
                        W sums[B] = {};
                        for (int p = 0; p < TAPS; p++)
                            for (int m = 0; m < B; m++) sums[m] += w[p] * static_cast<W>(pixels[q * line + p * pixel + m * band]);
                        for (int m = 0; m < B; m++) totals[m] += z[q] * sums[m];
                    }
                    for (int m = 0; m < B; m++) values[m] = totals[m];
                } else {
                    for (int64_t m = 0; m < bands; m++) {
                        W total = 0;
                        for (int q = 0; q < TAPS; q++) {
                            const T *const tap = pixels + q * line + m * band;
                            W sum = 0;
                            for (int p = 0; p < TAPS; p++) sum += w[p] * static_cast<W>(tap[p * pixel]);
                            total += z[q] * sum;
                        }
                        values[m] = total;
                    }
                }
            }
        }
    }

    // One band, whose samples follow each other: the taps of some pixels are brought together first, and the rest is done
    // for many pixels at once. Bilinear interpolation gains nothing by it.
    void take_together(const Window<T> &from, int64_t number, W *__restrict out) const {
        constexpr int64_t SOME = 64;
        struct Taps {
            T p[TAPS];
        } rows[TAPS][SOME];
        const T *__restrict const data = from.data;
        const int64_t line = from.line, size = capacity;
        for (int64_t start = 0; start < number; start += SOME) {
            const int64_t *__restrict const first = at + start;
            const W *__restrict const u = across + start, *__restrict const v = down + start;
            const int64_t some = smaller(SOME, number - start);
            for (int q = 0; q < TAPS; q++)
                for (int64_t c = 0; c < some; c++) memcpy(&rows[q][c], data + first[c] + q * line, sizeof(Taps));
            for (int64_t c = 0; c < some; c++) {
                W total = 0;
                for (int q = 0; q < TAPS; q++) {
                    W sum = 0;
                    for (int p = 0; p < TAPS; p++) sum += u[p * size + c] * static_cast<W>(rows[q][c].p[p]);
                    total += v[q * size + c] * sum;
                }
                out[start + c] = total;
            }
        }
    }

    template <int B>
    void take_run(const Window<T> &from, int64_t start, int64_t length, int64_t bands, W *__restrict out) const {
        const T *__restrict const first = from.data + at[start];
        const int64_t size = length * bands, line = from.line, row = B == 1 ? capacity : size;
        const W *__restrict u = across + start, *__restrict v = down + start;
        if constexpr (B != 1) {  // the weights of a pixel for each of its bands
            constexpr int each = METHOD == BILINEAR ? 1 : TAPS;
            W *__restrict const wide_u = wide, *__restrict const wide_v = wide + each * size;
            for (int p = 0; p < each; p++)
                for (int64_t c = 0; c < length; c++)
                    for (int64_t m = 0; m < bands; m++) {
                        wide_u[p * size + c * bands + m] = u[p * capacity + c];
                        wide_v[p * size + c * bands + m] = v[p * capacity + c];
                    }
            u = wide_u, v = wide_v;
        }
        if constexpr (METHOD == BILINEAR) {
            const T *__restrict const below = first + line;
            for (int64_t k = 0; k < size; k++) {
                const W top = between<W>(first[k], first[k + bands], u[k]), low = between<W>(below[k], below[k + bands], u[k]);
                out[k] = between<W>(top, low, v[k]);
            }
        } else {
            for (int64_t k = 0; k < size; k++) {
                W total = 0;
                for (int q = 0; q < TAPS; q++) {
                    const T *const tap = first + q * line + k;
                    W sum = 0;
                    for (int p = 0; p < TAPS; p++) sum += u[p * row + k] * static_cast<W>(tap[p * bands]);
                    total += v[q * row + k] * sum;
                }
                out[k] = total;
            }
        }
    }
};
