// Least squares matching of small patches; `matching/least_squares.py` says of what.
//
// Derivatives are those of the template, the same in every round (inverse compositional: Baker and Matthews, 2004), so
// that a round costs one interpolation of the patch and eight sums.

#include "array.hpp"

// Parameters: shift to the right and down, four of the affine part, gain, offset.
constexpr int TERMS = 8;
// The movement of the patch's corners, pixels, below which matching has ended; the steps after it are far smaller.
constexpr double CONVERGED = 0.005;

// Keys' cubic convolution, a = −0.5; NaN outside of the image.
template <class T>
static double cubic(const View<T, 2> &image, double x, double y) {
    const double fx = floor(x), fy = floor(y);
    // Written so that NaN fails as well.
    if (!(fx >= 1.0 && fy >= 1.0 && fx < image.shape[1] - 2 && fy < image.shape[0] - 2)) return NAN;
    const double s = x - fx, t = y - fy;
    const double wx[] = {((-0.5 * s + 1.0) * s - 0.5) * s, (1.5 * s - 2.5) * s * s + 1.0,
                         ((-1.5 * s + 2.0) * s + 0.5) * s, (0.5 * s - 0.5) * s * s};
    const double wy[] = {((-0.5 * t + 1.0) * t - 0.5) * t, (1.5 * t - 2.5) * t * t + 1.0,
                         ((-1.5 * t + 2.0) * t + 0.5) * t, (0.5 * t - 0.5) * t * t};
    const T *from = image.data + (static_cast<int64_t>(fy) - 1) * image.stride[0] + static_cast<int64_t>(fx) - 1;
    double sum = 0.0;
    for (int j = 0; j < 4; j++, from += image.stride[0])
        sum += wy[j] * (wx[0] * from[0] + wx[1] * from[1] + wx[2] * from[2] + wx[3] * from[3]);
    return sum;
}

// Cholesky factor in the lower triangle, in place; false where the matrix is not positive definite.
static bool factorise(double (&a)[TERMS][TERMS]) {
    for (int k = 0; k < TERMS; k++) {
        for (int i = 0; i < k; i++) {
            double sum = a[k][i];
            for (int j = 0; j < i; j++) sum -= a[k][j] * a[i][j];
            a[k][i] = sum / a[i][i];
        }
        double pivot = a[k][k];
        // What is left after rounding is no information.
        const double least = 1e-10 * pivot;
        for (int j = 0; j < k; j++) pivot -= a[k][j] * a[k][j];
        if (!(pivot > least)) return false;
        a[k][k] = sqrt(pivot);
    }
    return true;
}

static void substitute(const double (&a)[TERMS][TERMS], double *b) {
    for (int k = 0; k < TERMS; k++) {
        for (int j = 0; j < k; j++) b[k] -= a[k][j] * b[j];
        b[k] /= a[k][k];
    }
    for (int k = TERMS - 1; k >= 0; k--) {
        for (int j = k + 1; j < TERMS; j++) b[k] -= a[j][k] * b[j];
        b[k] /= a[k][k];
    }
}

// Patch of the first image about a pixel: its weighted derivatives and their normal equations.
struct Template {
    int64_t half, side, col = -1, row = -1;
    const double *weights;
    Buffer<double> columns, values;
    double factor[TERMS][TERMS], mean, power;
    bool usable = false;

    Template(int64_t half, const double *weights)
        : half(half), side(2 * half + 1), weights(weights), columns(side * side * TERMS), values(side * side) {}

    template <class T>
    void take(const View<T, 2> &image, int64_t to_col, int64_t to_row) {
        if (col == to_col && row == to_row) return;
        col = to_col, row = to_row, usable = false;
        if (col < half + 1 || row < half + 1 || col + half + 1 >= image.shape[1] || row + half + 1 >= image.shape[0])
            return;
        double normal[TERMS][TERMS] = {}, total = 0.0, sum = 0.0;
        for (int64_t j = -half, n = 0; j <= half; j++)
            for (int64_t i = -half; i <= half; i++, n++) {
                const double value = image(row + j, col + i), w = weights[n];
                const double right = 0.5 * (double(image(row + j, col + i + 1)) - double(image(row + j, col + i - 1)));
                const double down = 0.5 * (double(image(row + j + 1, col + i)) - double(image(row + j - 1, col + i)));
                const double a[] = {right, down, i * right, j * right, i * down, j * down, value, 1.0};
                values[n] = value, sum += w * value, total += w;
                for (int k = 0; k < TERMS; k++) {
                    columns[n * TERMS + k] = w * a[k];
                    for (int l = 0; l <= k; l++) normal[k][l] += w * a[k] * a[l];
                }
            }
        mean = sum / total, power = 0.0;
        for (int64_t n = 0; n < side * side; n++) power += weights[n] * (values[n] - mean) * (values[n] - mean);
        memcpy(factor, normal, sizeof normal);
        usable = factorise(factor);
    }
};

// Match of one patch: `warp` (a, b, c, d, col, row) is improved; false where it is lost.
template <class T>
static bool match(
    const Template &patch, const View<T, 2> &image, double *warp, int64_t rounds, double farthest, const double *patched,
    double *covariance, double &correlation
) {
    const int64_t half = patch.half, size = patch.side * patch.side;
    double *const seen = const_cast<double *>(patched);
    const double from_col = warp[4], from_row = warp[5];
    double solution[TERMS];
    bool done = false;
    for (int64_t round = 0; round <= rounds; round++) {
        for (int k = 0; k < TERMS; k++) solution[k] = 0.0;
        for (int64_t j = -half, n = 0; j <= half; j++)
            for (int64_t i = -half; i <= half; i++, n++) {
                const double value =
                    cubic(image, warp[4] + warp[0] * i + warp[1] * j, warp[5] + warp[2] * i + warp[3] * j);
                seen[n] = value;
                for (int k = 0; k < TERMS; k++) solution[k] += patch.columns[n * TERMS + k] * value;
            }
        substitute(patch.factor, solution);
        // A pixel outside of the image makes all of it NaN.
        if (!(solution[6] > 0.0)) return false;
        if (done || round == rounds) break;
        const double gain = solution[6];
        double step[6], reach = 0.0;
        for (int k = 0; k < 6; k++) step[k] = solution[k] / gain, reach += fabs(step[k]) * (k < 2 ? 1.0 : half);
        // The derivatives describe the patch no farther than about a pixel.
        const double shrink = reach > 2.0 ? 2.0 / reach : 1.0;
        for (int k = 0; k < 6; k++) step[k] *= shrink;
        // warp ∘ (I + step)⁻¹
        const double a = 1.0 + step[2], b = step[3], c = step[4], d = 1.0 + step[5], det = a * d - b * c;
        const double inverse[] = {d / det, -b / det, -c / det, a / det};
        const double A[] = {warp[0], warp[1], warp[2], warp[3]};
        for (int r = 0; r < 2; r++)
            for (int k = 0; k < 2; k++) warp[2 * r + k] = A[2 * r] * inverse[k] + A[2 * r + 1] * inverse[2 + k];
        warp[4] -= warp[0] * step[0] + warp[1] * step[1];
        warp[5] -= warp[2] * step[0] + warp[3] * step[1];
        if (!(fabs(warp[4] - from_col) + fabs(warp[5] - from_row) < farthest)) return false;
        done = reach < CONVERGED;
    }
    if (!done) return false;
    double mean = 0.0, total = 0.0, both = 0.0, power = 0.0, misfit = 0.0;
    for (int64_t n = 0; n < size; n++) mean += patch.weights[n] * seen[n], total += patch.weights[n];
    mean /= total;
    for (int64_t n = 0; n < size; n++) {
        const double w = patch.weights[n], off = seen[n] - mean;
        both += w * off * (patch.values[n] - patch.mean), power += w * off * off;
        const double left = seen[n] - solution[6] * patch.values[n] - solution[7];
        misfit += w * left * left;
    }
    correlation = both / sqrt(power * patch.power);
    // Of the shift in the template, which the affine part carries into the image.
    const double variance = misfit / (larger(total - TERMS, 1.0) * solution[6] * solution[6]);
    double q[2][TERMS] = {};
    for (int k = 0; k < 2; k++) q[k][k] = 1.0, substitute(patch.factor, q[k]);
    const double xx = variance * q[0][0], xy = variance * q[0][1], yy = variance * q[1][1];
    covariance[0] = warp[0] * warp[0] * xx + 2.0 * warp[0] * warp[1] * xy + warp[1] * warp[1] * yy;
    covariance[1] = warp[0] * warp[2] * xx + (warp[0] * warp[3] + warp[1] * warp[2]) * xy + warp[1] * warp[3] * yy;
    covariance[2] = warp[2] * warp[2] * xx + 2.0 * warp[2] * warp[3] * xy + warp[3] * warp[3] * yy;
    return true;
}

// Patches (N,) about pixels `places` (N, 2: col, row) of the first image, found in the second: `warps` (N, 6) hold the
// first approximation and then the result, counting from the centre of the first pixel. `weights` (side, side).
KERNEL int64_t match_patches(
    const Array *first, const Array *second, const Array *places, const Array *weights, int64_t rounds, double farthest,
    const Array *warps, const Array *covariances, const Array *correlations, int64_t from, int64_t to
) {
    if (first->type != second->type || !without_gaps(first, second)) return NO_FORM;
    return with_type(first->type, [&]<class T>() -> int64_t {
        const View<T, 2> one(first), other(second);
        const View<int64_t, 2> place(places);
        const View<double, 2> warp(warps), covariance(covariances);
        const View<double, 1> correlation(correlations);
        const int64_t half = weights->shape[0] / 2;
        Template patch(half, static_cast<const double *>(weights->data));
        const Buffer<double> seen(patch.side * patch.side);
        for (int64_t n = from; n < to; n++) {
            patch.take(one, place(n, 0), place(n, 1));
            double found = NAN;
            if (!patch.usable || !match(patch, other, warp.row(n), rounds, farthest, seen, covariance.row(n), found))
                found = NAN;
            correlation(n) = found;
        }
        return 0;
    });
}
