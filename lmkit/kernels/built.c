/* Instruction sets that this library was compiled for, as a constant: it is read before any code of it runs. */
#include "cpu_features.h"
#include "kernels.h"

extern const uint32_t lmkit_built_features;

LMKIT_EXPORT const uint32_t lmkit_built_features = 0
#ifdef __SSE4_2__
    | HAS_SSE4_2
#endif
#ifdef __AVX__
    | HAS_AVX
#endif
#ifdef __AVX2__
    | HAS_AVX2
#endif
#ifdef __FMA__
    | HAS_FMA
#endif
#ifdef __F16C__
    | HAS_F16C
#endif
#ifdef __BMI__
    | HAS_BMI
#endif
#ifdef __BMI2__
    | HAS_BMI2
#endif
#ifdef __LZCNT__
    | HAS_LZCNT
#endif
#ifdef __MOVBE__
    | HAS_MOVBE
#endif
#ifdef __AVX512F__
    | HAS_AVX512F
#endif
#ifdef __AVX512CD__
    | HAS_AVX512CD
#endif
#ifdef __AVX512BW__
    | HAS_AVX512BW
#endif
#ifdef __AVX512DQ__
    | HAS_AVX512DQ
#endif
#ifdef __AVX512VL__
    | HAS_AVX512VL
#endif
#ifdef __AVX512IFMA__
    | HAS_AVX512IFMA
#endif
#ifdef __AVX512VBMI__
    | HAS_AVX512VBMI
#endif
#ifdef __AVX512VBMI2__
    | HAS_AVX512VBMI2
#endif
#ifdef __AVX512VNNI__
    | HAS_AVX512VNNI
#endif
#ifdef __AVX512BITALG__
    | HAS_AVX512BITALG
#endif
#ifdef __AVX512VPOPCNTDQ__
    | HAS_AVX512VPOPCNTDQ
#endif
#ifdef __AVX512FP16__
    | HAS_AVX512FP16
#endif
#ifdef __AVX512BF16__
    | HAS_AVX512BF16
#endif
#ifdef __AVXVNNI__
    | HAS_AVXVNNI
#endif
#ifdef __ARM_FEATURE_SVE
    | HAS_SVE
#endif
#ifdef __ARM_FEATURE_DOTPROD
    | HAS_DOTPROD
#endif
    ;
