// A photograph's exposure, c' = c + A c + b, and its derivatives. Once per step.
#pragma once

#include <cstdint>

namespace radiant {

// `shown` (pixels,3) from `image` (pixels,3) and `map` (3,4): A beside b.
void apply_exposure(const float* image, const float* map, float* shown, std::int64_t height, std::int64_t width, int num_threads);

// From the derivative by what is shown: by the image, and by the map (3,4). Bits as for one thread.
void apply_exposure_backward(const float* image, const float* map, const float* shown_gradient, float* image_gradient, float* map_gradient,
                             std::int64_t height, std::int64_t width, int num_threads);

}  // namespace radiant
