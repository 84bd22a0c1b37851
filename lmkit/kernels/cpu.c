/* Instruction sets of this processor that its operating system lets programs use. */
#include "cpu_features.h"
#include "kernels.h"

LMKIT_EXPORT uint32_t lmkit_cpu_features(void);

#if defined(__x86_64__)

#include <cpuid.h>

static uint64_t enabled_state(void) {
    uint32_t low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return ((uint64_t)high << 32) | low;
}

static uint32_t bit(uint32_t word, int position, uint32_t feature) { return (word >> position) & 1u ? feature : 0; }

uint32_t lmkit_cpu_features(void) {
    uint32_t a, b, c, d, found = 0, avx = 0, avx512 = 0;
    if (!__get_cpuid(1, &a, &b, &c, &d)) return 0;
    const uint32_t ecx1 = c;
    /* ssse3, cx16, sse4.1, sse4.2, popcnt: x86-64-v2. */
    const uint32_t v2 = (1u << 9) | (1u << 13) | (1u << 19) | (1u << 20) | (1u << 23);
    if ((ecx1 & v2) == v2) found |= HAS_SSE4_2;
    found |= bit(ecx1, 22, HAS_MOVBE);
    /* Registers of AVX (bits 1, 2) and AVX-512 (5 to 7) must be saved by the operating system. */
    const uint64_t state = (ecx1 >> 27) & 1u ? enabled_state() : 0;
    const int os_avx = (state & 0x6) == 0x6, os_avx512 = (state & 0xe6) == 0xe6;
    avx |= bit(ecx1, 28, HAS_AVX) | bit(ecx1, 12, HAS_FMA) | bit(ecx1, 29, HAS_F16C);
    if (__get_cpuid(0x80000001u, &a, &b, &c, &d)) found |= bit(c, 5, HAS_LZCNT);
    if (__get_cpuid_count(7, 0, &a, &b, &c, &d)) {
        found |= bit(b, 3, HAS_BMI) | bit(b, 8, HAS_BMI2);
        avx |= bit(b, 5, HAS_AVX2);
        avx512 |= bit(b, 16, HAS_AVX512F) | bit(b, 17, HAS_AVX512DQ) | bit(b, 21, HAS_AVX512IFMA);
        avx512 |= bit(b, 28, HAS_AVX512CD) | bit(b, 30, HAS_AVX512BW) | bit(b, 31, HAS_AVX512VL);
        avx512 |= bit(c, 1, HAS_AVX512VBMI) | bit(c, 6, HAS_AVX512VBMI2) | bit(c, 11, HAS_AVX512VNNI);
        avx512 |= bit(c, 12, HAS_AVX512BITALG) | bit(c, 14, HAS_AVX512VPOPCNTDQ) | bit(d, 23, HAS_AVX512FP16);
    }
    if (__get_cpuid_count(7, 1, &a, &b, &c, &d)) {
        avx |= bit(a, 4, HAS_AVXVNNI);
        avx512 |= bit(a, 5, HAS_AVX512BF16);
    }
    return found | (os_avx ? avx : 0) | (os_avx512 ? avx512 : 0);
}

#else

uint32_t lmkit_cpu_features(void) { return HAS_DOTPROD; }

#endif
