// What the library says of itself and of the processor.

#include "array.hpp"
#ifdef __x86_64__
#include <cpuid.h>
#endif

KERNEL const char *sources() { return SOURCES; }

// 0 where there are those that every processor of the kind has, 1 with AVX2, 2 with AVX-512.
KERNEL int64_t vector_instructions() {
#ifdef __x86_64__
    // Asked of the processor: what the compiler brings for it (`__builtin_cpu_supports`) found nothing, as Zig builds it.
    unsigned a, b, c, d, basic, extended, kept, rest;
    if (!__get_cpuid(1, &a, &b, &basic, &d) || !__get_cpuid_count(7, 0, &a, &extended, &c, &d)) return 0;
    if (!__get_cpuid(0x80000001, &a, &b, &c, &d) || !(basic & bit_OSXSAVE)) return 0;
    // The system must keep the wide registers, too, when it changes from one process to the next.
    asm("xgetbv" : "=a"(kept), "=d"(rest) : "c"(0));
    constexpr unsigned first = bit_FMA | bit_MOVBE | bit_F16C, second = bit_AVX2 | bit_BMI | bit_BMI2;
    if ((basic & first) != first || (extended & second) != second || !(c & bit_LZCNT) || (kept & 0x06) != 0x06) return 0;
    constexpr unsigned wide = bit_AVX512F | bit_AVX512BW | bit_AVX512CD | bit_AVX512DQ | bit_AVX512VL;
    return (extended & wide) == wide && (kept & 0xe6) == 0xe6 ? 2 : 1;
#else
    return 0;
#endif
}
