/* Bits for the instruction sets that compilers use without being asked; the same in cpu.c (sets of the processor) and
 * built.c (sets that the library was compiled for). */
#ifndef LMKIT_CPU_FEATURES_H
#define LMKIT_CPU_FEATURES_H

enum {
    HAS_SSE4_2 = 1 << 0, /* stands for all of x86-64-v2 */
    HAS_AVX = 1 << 1,
    HAS_AVX2 = 1 << 2,
    HAS_FMA = 1 << 3,
    HAS_F16C = 1 << 4,
    HAS_BMI = 1 << 5,
    HAS_BMI2 = 1 << 6,
    HAS_LZCNT = 1 << 7,
    HAS_MOVBE = 1 << 8,
    HAS_AVX512F = 1 << 9,
    HAS_AVX512CD = 1 << 10,
    HAS_AVX512BW = 1 << 11,
    HAS_AVX512DQ = 1 << 12,
    HAS_AVX512VL = 1 << 13,
    HAS_AVX512IFMA = 1 << 14,
    HAS_AVX512VBMI = 1 << 15,
    HAS_AVX512VBMI2 = 1 << 16,
    HAS_AVX512VNNI = 1 << 17,
    HAS_AVX512BITALG = 1 << 18,
    HAS_AVX512VPOPCNTDQ = 1 << 19,
    HAS_AVX512FP16 = 1 << 20,
    HAS_AVX512BF16 = 1 << 21,
    HAS_AVXVNNI = 1 << 22,
    HAS_SVE = 1 << 23, /* arm64: not queried at run time, so such a library is refused on other processors */
    HAS_DOTPROD = 1 << 24
};

#endif
