/* Shared by all kernels.  Kernels take arrays and numbers and fill arrays; they allocate nothing, keep nothing between
 * calls, start no thread, and return a status: 0 for done. */
#ifndef LMKIT_KERNELS_H
#define LMKIT_KERNELS_H

#include <stdint.h>

#if defined(_WIN32)
#define LMKIT_EXPORT __declspec(dllexport)
#else
#define LMKIT_EXPORT __attribute__((visibility("default")))
#endif

#endif
