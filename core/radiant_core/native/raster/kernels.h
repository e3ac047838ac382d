// The kernels of every instruction set in this build.
#pragma once

#include "raster/types.h"

namespace radiant {
#if defined(RADIANT_X86)
namespace avx512 { extern const Kernels kernels; }
namespace avx2 { extern const Kernels kernels; }
#endif
namespace portable { extern const Kernels kernels; }
}  // namespace radiant
