// What the library says of itself and of the processor.

#include "array.hpp"

KERNEL const char *sources() { return SOURCES; }

// 0 where there are those that every processor of the kind has, 1 with AVX2, 2 with AVX-512.
KERNEL int64_t vector_instructions() {
#ifdef __x86_64__
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") &&
        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
        return 2;
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2") &&
        __builtin_cpu_supports("lzcnt"))
        return 1;
#endif
    return 0;
}
