// Values of cubic polynomials in three variables: of RPCs, in the order of terms of RPC00B.

#include "array.hpp"

constexpr int64_t TERMS = 20;

// `coefficients` (K, 20), `places` (N, 3), `values` (K, N). Sums go in the order of the terms.
KERNEL int64_t cubic_polynomials(const Array *coefficients, const Array *places, const Array *values) {
    const View<double, 2> factor(coefficients), place(places), value(values);
    if (!without_gaps(values)) return NO_FORM;
    constexpr int64_t SOME = 64;  // places at a time: their terms stay in the nearest cache
    double term[TERMS][SOME], sum[SOME];
    for (int64_t start = 0; start < place.shape[0]; start += SOME) {
        const int64_t some = smaller(SOME, place.shape[0] - start);
        for (int64_t n = 0; n < some; n++) {
            const double l = place(start + n, 0), p = place(start + n, 1), h = place(start + n, 2);
            const double all[TERMS] = {1.0,       l,           p,           h,         l * p,     l * h,     p * h,
                                       l * l,     p * p,       h * h,       l * p * h, l * l * l, l * (p * p), l * (h * h),
                                       l * l * p, p * p * p,   p * (h * h), l * l * h, p * p * h, h * h * h};
            for (int64_t k = 0; k < TERMS; k++) term[k][n] = all[k];
        }
        for (int64_t polynomial = 0; polynomial < factor.shape[0]; polynomial++) {
            for (int64_t n = 0; n < some; n++) sum[n] = 0.0;
            for (int64_t k = 0; k < TERMS; k++) {
                const double c = factor(polynomial, k);
                for (int64_t n = 0; n < some; n++) sum[n] += c * term[k][n];
            }
            memcpy(value.row(polynomial) + start, sum, some * sizeof(double));
        }
    }
    return 0;
}
