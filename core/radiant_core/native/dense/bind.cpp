// Checks every array, lets go of the interpreter lock, calls the kernels.
#include "dense/bind.h"

#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <cstdint>
#include <memory>
#include <string>
#include <tuple>
#include <vector>

#include "dense/agree.h"
#include "dense/dense.h"

namespace nb = nanobind;
using nb::literals::operator""_a;

namespace {

using Grey = nb::ndarray<const std::uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Doubles = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Planes = nb::ndarray<const float, nb::ndim<4>, nb::c_contig, nb::device::cpu>;
using Found = nb::ndarray<nb::numpy, float, nb::ndim<3>>;
using OwnPlanes = nb::ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Costs = nb::ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Sums = nb::ndarray<nb::numpy, double, nb::ndim<2>>;
using Counts = nb::ndarray<nb::numpy, std::int32_t, nb::ndim<1>>;

constexpr std::size_t kMaxPixels = std::size_t{1} << 24;
constexpr std::size_t kMaxReach = 16;

[[noreturn]] void raise(const std::string& message) { throw nb::value_error(message.c_str()); }

void check_grey(const Grey& image, const std::string& name) {
  if (image.shape(0) < 2 || image.shape(1) < 2 || image.size() >= kMaxPixels)
    raise(name + " has shape (" + std::to_string(image.shape(0)) + ", " + std::to_string(image.shape(1)) + "), expected 2 by 2 to 2^24 pixels");
}

void check_doubles(const Doubles& array, const std::string& name, std::size_t count) {
  if (array.size() != count) raise(name + " has " + std::to_string(array.size()) + " numbers, expected " + std::to_string(count));
  for (std::size_t i = 0; i < count; ++i)
    if (!std::isfinite(array.data()[i])) raise(name + " has a number that is not finite at index " + std::to_string(i));
}

Found match_planes(const Grey& reference, const std::vector<Grey>& sources, const Doubles& maps, const Planes& candidates, const Doubles& camera,
                   const Doubles& limits, const Doubles& passes, std::uint32_t seed, int num_threads, const std::string& instruction_set) {
  const radiant::DenseKernels* kernels = radiant::find_dense_kernels(instruction_set);
  if (!kernels) raise("instruction_set '" + instruction_set + "' is unknown or not this CPU's: see instruction_sets()");
  check_grey(reference, "reference");
  if (sources.empty() || sources.size() > radiant::kMaxSources)
    raise("sources has " + std::to_string(sources.size()) + " images, expected 1 to " + std::to_string(radiant::kMaxSources));
  for (const Grey& source : sources) check_grey(source, "a source");
  check_doubles(maps, "maps", 12 * sources.size());
  check_doubles(camera, "camera", 6);
  check_doubles(limits, "limits", 4);
  if (passes.size() % 2) raise("passes has " + std::to_string(passes.size()) + " numbers, expected pairs of reach and amplitude");
  check_doubles(passes, "passes", passes.size());
  if (candidates.shape(0) == 0 || candidates.shape(1) != 3) raise("candidates has another shape than (Q, 3, R, C) with Q of at least 1");

  radiant::DepthJob job{};
  job.reference = reference.data();
  job.height = static_cast<std::int32_t>(reference.shape(0)), job.width = static_cast<std::int32_t>(reference.shape(1));
  job.rows = static_cast<std::int64_t>(candidates.shape(2)), job.columns = static_cast<std::int64_t>(candidates.shape(3));
  const auto real = [](const Doubles& array, std::size_t index) { return static_cast<float>(array.data()[index]); };
  job.focal_x = real(camera, 0), job.focal_y = real(camera, 1), job.center_x = real(camera, 2), job.center_y = real(camera, 3);
  job.first = real(camera, 4), job.step = real(camera, 5);
  job.least = real(limits, 0), job.most = real(limits, 1), job.min_cosine = real(limits, 2), job.pixel = real(limits, 3);
  std::vector<radiant::DepthPass> steps;
  for (std::size_t index = 0; index < passes.size(); index += 2) {
    const double reach = passes.data()[index];
    if (!(reach >= 0 && reach <= kMaxReach)) raise("passes has a reach of " + std::to_string(reach) + ", expected 0 to 16");
    steps.push_back({static_cast<std::int32_t>(reach), real(passes, index + 1), seed + 0x3c6ef35fu * static_cast<std::uint32_t>(index + 1)});
  }
  const std::size_t nodes = candidates.shape(2) * candidates.shape(3);
  auto found = std::make_unique<float[]>(4 * nodes);
  if (nodes) {
    const nb::gil_scoped_release unlocked;
    std::vector<std::vector<std::uint32_t>> quads;
    std::vector<radiant::DepthSource> views(sources.size());
    for (std::size_t index = 0; index < sources.size(); ++index) {
      const auto height = static_cast<std::int32_t>(sources[index].shape(0)), width = static_cast<std::int32_t>(sources[index].shape(1));
      quads.push_back(radiant::grey_quads(sources[index].data(), width, height));
      views[index].quads = quads.back().data();
      views[index].width = width, views[index].height = height;
      for (int i = 0; i < 9; ++i) views[index].matrix[i] = real(maps, 12 * index + i);
      for (int i = 0; i < 3; ++i) views[index].offset[i] = real(maps, 12 * index + 9 + i);
    }
    job.sources = views.data();
    job.num_sources = static_cast<std::int32_t>(views.size());
    radiant::match_planes(job, candidates.data(), static_cast<std::int64_t>(candidates.shape(0)), steps, found.get(), found.get() + 3 * nodes,
                          *kernels, num_threads);
  }
  float* data = found.release();
  nb::capsule owner(data, [](void* pointer) noexcept { delete[] static_cast<float*>(pointer); });
  return Found(data, {4, candidates.shape(2), candidates.shape(3)}, owner);
}

radiant::PlaneView plane_view(const OwnPlanes& planes, const double* camera) {
  if (planes.shape(0) != 3) raise("planes have shape (" + std::to_string(planes.shape(0)) + ", R, C), expected (3, R, C)");
  if (!(camera[0] > 0 && camera[1] > 0 && camera[5] > 0)) raise("a camera has a focal length or a step that is not positive");
  radiant::PlaneView view{};
  view.planes = planes.data();
  view.rows = static_cast<std::int64_t>(planes.shape(1)), view.columns = static_cast<std::int64_t>(planes.shape(2));
  view.focal_x = camera[0], view.focal_y = camera[1], view.center_x = camera[2], view.center_y = camera[3];
  view.first = camera[4], view.step = camera[5];
  for (int i = 0; i < 12; ++i) view.pose[i] = camera[6 + i];
  return view;
}

std::tuple<Sums, Counts> sum_agreeing(const std::vector<OwnPlanes>& planes, const Costs& costs, const Doubles& cameras, const Doubles& limits) {
  constexpr std::size_t kNumbers = 18;
  if (planes.empty()) raise("planes is empty, expected those of the photograph and of its partners");
  check_doubles(cameras, "cameras", kNumbers * planes.size());
  check_doubles(limits, "limits", 3);
  std::vector<radiant::PlaneView> views;
  for (std::size_t index = 0; index < planes.size(); ++index) views.push_back(plane_view(planes[index], cameras.data() + kNumbers * index));
  const radiant::PlaneView own = views.front();
  views.erase(views.begin());
  if (costs.shape(0) != planes[0].shape(1) || costs.shape(1) != planes[0].shape(2)) raise("costs has another shape than the planes of its photograph");
  const std::size_t nodes = costs.size();
  auto sums = std::make_unique<double[]>(3 * nodes);
  auto counts = std::make_unique<std::int32_t[]>(nodes);
  {
    const nb::gil_scoped_release unlocked;
    radiant::sum_agreeing(own, costs.data(), views, {limits.data()[0], limits.data()[1], limits.data()[2]}, sums.get(), counts.get());
  }
  double* of_points = sums.release();
  nb::capsule own_points(of_points, [](void* pointer) noexcept { delete[] static_cast<double*>(pointer); });
  std::int32_t* of_nodes = counts.release();
  nb::capsule own_nodes(of_nodes, [](void* pointer) noexcept { delete[] static_cast<std::int32_t*>(pointer); });
  return {Sums(of_points, {nodes, 3}, own_points), Counts(of_nodes, {nodes}, own_nodes)};
}

}  // namespace

void bind_dense(nb::module_& module) {
  module.def("match_planes", &match_planes, "reference"_a, "sources"_a, "maps"_a, "candidates"_a, "camera"_a, "limits"_a, "passes"_a,
             "seed"_a = 0, "num_threads"_a = 1, "instruction_set"_a = "",
             "Planes of inverse depth and their costs (4,R,C) of a lattice of pixels of a grey image (H,W) uint8 against V sources.\n\n"
             "maps (V,12): 3 x 3 matrix and offset, p' = M (x,y,1) + m w; pixels count from the middle of the first one.\n"
             "candidates (Q,3,R,C): first planes, w at the node and its slopes. camera: fx, fy, cx, cy, first node, step.\n"
             "limits: least and most w, least cosine of a plane's normal and the line of sight, change of w for a pixel in a source.\n"
             "passes: pairs of reach in nodes and amplitude in pixels. Raises ValueError for wrong shapes and values not finite.");
  module.def("sum_agreeing", &sum_agreeing, "planes"_a, "costs"_a, "cameras"_a, "limits"_a,
             "Sums (R C,3) of each node's point and those of the partners that agree with it, and how many do (R C,).\n\n"
             "planes: (3,R,C) of the photograph, then of its partners. costs (R,C) of the photograph's own.\n"
             "cameras (V,18): fx, fy, cx, cy, first node, step and camera from world (3,4), pixels count from the middle of the first one.\n"
             "limits: cost from which a plane is no match, pixels between a node and a partner's point, relative difference of depths.\n"
             "Both are 0 where a node has no plane or costs too much. Raises ValueError for wrong shapes and values not finite.");
}
