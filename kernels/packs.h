// Packs: items that are a long chain of dependent steps, or similar and next to each other. On a CPU every PACKth item
// owns PACK of them, one per lane, and the items between do nothing; on a GPU an item owns one.
#include "common.h"
#ifdef CPU
#define PACK 16
typedef float16 Real;
typedef int16 Whole;
#define ANY(mask) any(mask)
#define TO_REAL(value) convert_float16(value)
#define TO_WHOLE(value) convert_int16(value)
#define NUMBERS (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
#define PACK_KERNEL __kernel __attribute__((vec_type_hint(float16))) void
#else
#define PACK 1
typedef float Real;
typedef int Whole;
#define ANY(mask) (mask)
#define TO_REAL(value) convert_float(value)
#define TO_WHOLE(value) convert_int(value)
#define NUMBERS 0
#define PACK_KERNEL __kernel void
#endif
