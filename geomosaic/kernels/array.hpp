// Arrays as NumPy has them, and the choice of a kernel's form by the type of their elements.

#pragma once

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define KERNEL extern "C" __attribute__((visibility("default")))

// What a kernel returns where it has no form for the types of its arrays.
constexpr int64_t NO_FORM = INT64_MIN;

// The order is that of `TYPES` in library.py.
enum Type : int64_t { U8, I8, U16, I16, U32, I32, U64, I64, F32, F64 };

// Strides count elements.
struct Array {
    void *data;
    int64_t type, shape[4], stride[4];
};

// Array of known type and number of axes.
template <class T, int AXES>
struct View {
    T *data;
    int64_t shape[AXES], stride[AXES];

    View(const Array *array) : data(static_cast<T *>(array->data)) {
        for (int k = 0; k < AXES; k++) shape[k] = array->shape[k], stride[k] = array->stride[k];
    }

    template <class... Index>
    T &operator()(Index... index) const {
        const int64_t places[] = {static_cast<int64_t>(index)...};
        int64_t at = 0;
        for (int k = 0; k < AXES; k++) at += places[k] * stride[k];
        return data[at];
    }

    T *row(int64_t index) const { return data + index * stride[0]; }
};

// Whether rows of arrays (rows, cols) are without gaps, so that a plain pointer goes along them.
template <class... Arrays>
bool without_gaps(const Arrays *...arrays) {
    return ((arrays->stride[1] == 1 || arrays->shape[1] < 2) && ...);
}

// Memory of a kernel, freed at its end. Loops take its pointer once, as `local`: a store through a pointer to bytes may
// change anything, and the compiler would load members again in every turn.
template <class T>
struct Buffer {
    T *data;

    explicit Buffer(int64_t size) : data(static_cast<T *>(malloc(size * sizeof(T)))) {}
    Buffer(const Buffer &) = delete;
    ~Buffer() { free(data); }
    operator T *() const { return data; }
};

// Two numbers that follow each other.
template <class T>
struct Pair {
    T first, second;
};

// Cells of CELL x CELL pixels are what is wanted, or not, of a block.
constexpr int64_t CELL = 64;

// Call a generic lambda with the type of an array's elements: with_type(array->type, [&]<class T>() { ... }).
template <class Form>
int64_t with_type(int64_t type, const Form &form) {
    switch (type) {
        case U8: return form.template operator()<uint8_t>();
        case I8: return form.template operator()<int8_t>();
        case U16: return form.template operator()<uint16_t>();
        case I16: return form.template operator()<int16_t>();
        case U32: return form.template operator()<uint32_t>();
        case I32: return form.template operator()<int32_t>();
        case U64: return form.template operator()<uint64_t>();
        case I64: return form.template operator()<int64_t>();
        case F32: return form.template operator()<float>();
        case F64: return form.template operator()<double>();
        default: return NO_FORM;
    }
}

// The same for the two floating-point types.
template <class Form>
int64_t with_float(int64_t type, const Form &form) {
    switch (type) {
        case F32: return form.template operator()<float>();
        case F64: return form.template operator()<double>();
        default: return NO_FORM;
    }
}

template <class T>
inline T smaller(T a, T b) {
    return b < a ? b : a;
}

template <class T>
inline T larger(T a, T b) {
    return a < b ? b : a;
}

// Rounded, halves up, and brought into the range of a type of whole numbers; NaN becomes the lowest of them.
inline double rounded(double value, double low, double high) { return smaller(larger(low, floor(value + 0.5)), high); }
inline float rounded(float value, float low, float high) { return smaller(larger(low, floorf(value + 0.5f)), high); }

// A number as another type, in whose range it lies.
template <class T, class E>
inline T as(E value) {
    constexpr bool is_whole = T(0.5f) == T(0), is_signed = T(-1) < T(0), from_whole = E(0.5f) == E(0);
    // The highest value of such a type is no floating-point number of type E; the next one that is overflows.
    if constexpr (is_whole && !from_whole && sizeof(T) >= sizeof(E)) {
        constexpr T middle = T(1) << (8 * sizeof(T) - 1 - is_signed), highest = middle - 1 + middle;
        return value < E(2) * E(middle) ? static_cast<T>(value) : highest;
    }
    return static_cast<T>(value);
}
