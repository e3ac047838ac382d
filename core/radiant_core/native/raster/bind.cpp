// The Python border of the rasterizer: sizes; shapes and finite values are checked in contract.py.
#include "raster/bind.h"

#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "raster/raster.h"

namespace nb = nanobind;
using nb::literals::operator""_a;

namespace radiant {
namespace {

using Floats = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<float, nb::c_contig, nb::device::cpu>;
using Doubles = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;

// Size of an array of `expected` numbers; a mistake here would write over foreign memory.
template <class Array>
auto* checked(const Array& array, std::int64_t expected, const char* name) {
  if (static_cast<std::int64_t>(array.size()) != expected)
    throw nb::value_error((std::string(name) + " holds " + std::to_string(array.size()) + " numbers, expected " + std::to_string(expected)).c_str());
  return array.data();
}

template <class Array>
auto* checked(const std::optional<Array>& array, std::int64_t expected, const char* name) {
  return array ? checked(*array, expected, name) : nullptr;
}

const Kernels& kernels_named(const std::string& name) {
  const Kernels* kernels = find_kernels(name);
  if (!kernels) throw nb::value_error(("instruction set '" + name + "' is not one of this CPU and build").c_str());
  return *kernels;
}

SplatArrays splat_arrays(const std::vector<Floats>& splats) {
  if (splats.size() != 6) throw nb::value_error("splats holds other than six arrays");
  const auto count = static_cast<std::int64_t>(splats[3].size());
  const int num_rest = splats[5].ndim() == 3 ? static_cast<int>(splats[5].shape(1)) : 0;
  return {count,
          num_rest,
          checked(splats[0], 3 * count, "means"),
          checked(splats[1], 4 * count, "quats"),
          checked(splats[2], 3 * count, "log_scales"),
          splats[3].data(),
          checked(splats[4], 3 * count, "sh0"),
          checked(splats[5], 3 * num_rest * count, "shN")};
}

View make_view(const Doubles& viewmat, const Doubles& K, int width, int height, int sh_degree, double near_m, double far_m, bool antialiased,
               const Floats& background) {
  const double *m = checked(viewmat, 16, "viewmat"), *k = checked(K, 9, "K");
  View view{};
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) view.rotation[3 * row + column] = m[4 * row + column];
    view.translation[row] = m[4 * row + 3];
  }
  for (int axis = 0; axis < 3; ++axis)
    for (int row = 0; row < 3; ++row) view.center[axis] -= view.rotation[3 * row + axis] * view.translation[row];
  view.fx = k[0], view.cx = k[2], view.fy = k[4], view.cy = k[5];
  view.near_m = near_m, view.far_m = far_m;
  view.width = width, view.height = height;
  view.tiles_x = (width + kTilePx - 1) / kTilePx, view.tiles_y = (height + kTilePx - 1) / kTilePx;
  view.sh_degree = sh_degree;
  view.antialiased = antialiased;
  for (int c = 0; c < 3; ++c) view.background[c] = checked(background, 3, "background")[c];
  return view;
}

// A view with what its kernels need to go back.
struct PyRenderedView {
  RenderedView rendered;
  int width = 0, height = 0, num_rest = 0;
  std::int64_t count = 0;
  bool differentiable = false;

  void check_differentiable() const {
    if (!differentiable) throw nb::value_error("there is no rendering with differentiable=True to go back from");
  }
};

void forward(PyRenderedView& self, const std::string& instruction_set, const std::vector<Floats>& splats, const Doubles& viewmat, const Doubles& K,
             int width, int height, int sh_degree, double near_m, double far_m, bool antialiased, const Floats& background, const Output& images,
             const Output& alphas, const Output& depths, const Output& means2d, const Output& radii_px, bool differentiable, int threads) {
  const SplatArrays arrays = splat_arrays(splats);
  if (width < 1 || height < 1 || threads < 1) throw nb::value_error("width, height and threads must be at least 1");
  if (width > kMaxSidePx || height > kMaxSidePx) throw nb::value_error("width and height must be at most 1000000");
  if (sh_degree < 0 || sh_degree > 3 || (sh_degree + 1) * (sh_degree + 1) > arrays.num_rest + 1)
    throw nb::value_error("sh_degree is larger than shN can hold");
  const View view = make_view(viewmat, K, width, height, sh_degree, near_m, far_m, antialiased, background);
  const std::int64_t pixels = static_cast<std::int64_t>(width) * height;
  const ViewOutputs out{checked(images, 3 * pixels, "images"), checked(alphas, pixels, "alphas"), checked(depths, pixels, "depths"),
                        checked(means2d, 2 * arrays.count, "means2d"), checked(radii_px, arrays.count, "radii_px")};
  const Kernels& kernels = kernels_named(instruction_set);
  self.width = width, self.height = height, self.count = arrays.count, self.num_rest = arrays.num_rest;
  self.differentiable = false;
  nb::gil_scoped_release unlocked;
  self.rendered.forward(kernels, view, arrays, out, differentiable, threads);
  self.differentiable = differentiable;
}

void blend_backward(const PyRenderedView& self, const Floats& images, const std::optional<Floats>& alphas, const std::optional<Floats>& depths,
                    const Floats& out_alphas, const Floats& out_depths, const Output& means2d, const Output& sums,
                    const std::optional<Output>& absgrad, const std::optional<Output>& weights, int threads) {
  self.check_differentiable();
  const std::int64_t pixels = static_cast<std::int64_t>(self.width) * self.height;
  const ImageGradients gradients{checked(images, 3 * pixels, "images"), checked(alphas, pixels, "alphas"),
                                 checked(depths, pixels, "depths"), checked(out_alphas, pixels, "out_alphas"),
                                 checked(out_depths, pixels, "out_depths")};
  float* to = checked(means2d, 2 * self.count, "means2d");
  auto* to_sums = reinterpret_cast<Moments*>(checked(sums, kMoments * self.count, "sums"));
  float* to_absgrad = checked(absgrad, 2 * self.count, "absgrad");
  float* to_weights = checked(weights, self.count, "weights");
  if (!to_absgrad != !to_weights) throw std::invalid_argument("absgrad and weights are both arrays or both None");
  nb::gil_scoped_release unlocked;
  self.rendered.blend_backward(gradients, to, to_sums, to_absgrad, to_weights, threads);
}

void project_backward(const PyRenderedView& self, const std::vector<Floats>& splats, const Floats& means2d, const Floats& sums,
                      const std::vector<std::optional<Output>>& gradients, bool add, int threads) {
  self.check_differentiable();
  const SplatArrays arrays = splat_arrays(splats);
  if (arrays.count != self.count || arrays.num_rest != self.num_rest || gradients.size() != 6)
    throw nb::value_error("splats are not those of the forward pass");
  const std::int64_t n = arrays.count;
  const SplatGradients to{checked(gradients[0], 3 * n, "means"),
                          checked(gradients[1], 4 * n, "quats"),
                          checked(gradients[2], 3 * n, "log_scales"),
                          checked(gradients[3], n, "logit_opacities"),
                          checked(gradients[4], 3 * n, "sh0"),
                          checked(gradients[5], 3 * arrays.num_rest * n, "shN"),
                          add, false};
  const float* from = checked(means2d, 2 * n, "means2d");
  const auto* from_sums = reinterpret_cast<const Moments*>(checked(sums, kMoments * n, "sums"));
  nb::gil_scoped_release unlocked;
  self.rendered.project_backward(arrays, from, from_sums, to, threads);
}

nb::ndarray<nb::numpy, float> pooled_array(const std::vector<std::size_t>& shape) {
  std::size_t size = 1;
  for (const std::size_t side : shape) size *= side;
  void* memory = pool_take(size * sizeof(float));
  const nb::capsule owner(memory, [](void* pointer) noexcept { pool_return(pointer); });
  return {static_cast<float*>(memory), shape.size(), shape.data(), owner};
}

std::vector<std::string> instruction_sets() {
  std::vector<std::string> names;
  for (const char* name : {"avx512", "avx2", "portable"})
    if (find_kernels(name)) names.emplace_back(name);
  return names;
}

std::int64_t multiply_adds(const std::string& instruction_set, std::int64_t rounds) {
  const Kernels& kernels = kernels_named(instruction_set);
  nb::gil_scoped_release unlocked;
  volatile float keep = 0;
  float sum = 0;
  const std::int64_t done = kernels.fma_rounds(rounds, &sum);
  keep = sum;
  static_cast<void>(keep);
  return done;
}

std::string compiler() {
#if defined(__clang__)
  return "clang " + std::to_string(__clang_major__) + "." + std::to_string(__clang_minor__);
#else
  return "gcc " + std::to_string(__GNUC__) + "." + std::to_string(__GNUC_MINOR__);
#endif
}

}  // namespace

void bind_raster(nb::module_& module) {
  nb::class_<PyRenderedView>(module, "RenderedView",
                             "One view of a model: what its rendering leaves for the gradients, which several threads may take at once.")
      .def(nb::init<>())
      .def("forward", &forward, "instruction_set"_a, "splats"_a, "viewmat"_a, "K"_a, "width"_a, "height"_a, "sh_degree"_a, "near_m"_a, "far_m"_a,
           "antialiased"_a, "background"_a, "images"_a.noconvert(), "alphas"_a.noconvert(), "depths"_a.noconvert(), "means2d"_a.noconvert(),
           "radii_px"_a.noconvert(), "differentiable"_a, "threads"_a,
           "Render into images (H,W,3), alphas (H,W), depths (H,W) m, means2d (N,2) px, radii_px (N). splats: means, quats, log_scales,\n"
           "logit_opacities, sh0, shN, float32; viewmat (4,4), K (3,3) float64. ValueError for a wrong size or instruction set.")
      .def("blend_backward", &blend_backward, "images"_a, "alphas"_a.none(), "depths"_a.none(), "out_alphas"_a, "out_depths"_a,
           "means2d"_a.noconvert(), "sums"_a.noconvert(), "absgrad"_a.noconvert().none(), "weights"_a.noconvert().none(),
           "threads"_a,
           "Gradients of images (H,W,3), alphas and depths (H,W) or None into means2d (N,2) and, for all else, sums (N,NUM_MOMENTS);\n"
           "into absgrad (N,2) and weights (N), if they are not None, the sums over pixels of |gradient of means2d| and of T α.")
      .def("project_backward", &project_backward, "splats"_a, "means2d"_a, "sums"_a, "gradients"_a.noconvert(), "add"_a, "threads"_a,
           "Gradients of the six tensors, from blend_backward's means2d and sums, into arrays or None; added or overwritten.")
      .def_prop_ro("num_instances", [](const PyRenderedView& self) { return self.rendered.num_instances(); }, "Pairs of Gaussian and 16 px tile.")
      .def_prop_ro("num_block_pairs", [](const PyRenderedView& self) { return self.rendered.num_block_pairs(); },
                   "Pairs of Gaussian and 4 px block.");
  module.attr("NUM_MOMENTS") = kMoments;
  module.def("pooled_array", &pooled_array, "shape"_a, "Uninitialised float32 array whose memory is used again after it was freed.");
  module.def("instruction_sets", &instruction_sets, "Those this CPU and build have, the fastest first.");
  module.def("compiler", &compiler, "Name and version of the compiler of this build.");
  module.def("multiply_adds", &multiply_adds, "instruction_set"_a, "rounds"_a,
             "Do `rounds` rounds of independent fused multiply-adds; returns how many of 16 lanes they were.");
}

}  // namespace radiant
