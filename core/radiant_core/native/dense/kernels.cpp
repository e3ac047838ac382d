// The kernels of dense depth for one instruction set, RADIANT_ISA; dense.cmake compiles each.
//
// Nothing here may come from a standard header's templates: the linker keeps one copy of those, and
// it might be one that the CPU cannot run.
#include "dense/kernels.h"

#include "machine/simd.h"
#include "machine/simd_math.h"

#include "dense/cost.h"
#include "dense/search.h"

#define RADIANT_TEXT_OF(name) #name
#define RADIANT_TEXT(name) RADIANT_TEXT_OF(name)

namespace radiant::RADIANT_ISA {

extern const DenseKernels dense_kernels;
const DenseKernels dense_kernels = {RADIANT_TEXT(RADIANT_ISA), try_rows, pass_rows};

}  // namespace radiant::RADIANT_ISA
