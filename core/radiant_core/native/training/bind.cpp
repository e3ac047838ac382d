// Checks every array, lets go of the interpreter lock, calls the kernel.
#include "training/bind.h"

#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cfloat>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "training/adam.h"
#include "training/isa.h"
#include "training/loss.h"

namespace nb = nanobind;
using nb::literals::operator""_a;

namespace {

template <class Value>
using Array = nb::ndarray<Value, nb::c_contig, nb::device::cpu>;
using In = Array<const float>;
using Out = Array<float>;
using Runs = Array<const std::int32_t>;
using Shape = std::vector<std::size_t>;

[[noreturn]] void raise(const std::string& message) { throw nb::value_error(message.c_str()); }

std::string listed(const Shape& numbers) {
  std::string text = "(";
  for (std::size_t i = 0; i < numbers.size(); ++i) text += (i ? ", " : "") + std::to_string(numbers[i]);
  return text + (numbers.size() == 1 ? ",)" : ")");
}

template <class Value>
Shape shape_of(const Array<Value>& array) {
  return {array.shape_ptr(), array.shape_ptr() + array.ndim()};
}

template <class Value>
void check_shape(const Array<Value>& array, const std::string& name, const Shape& expected) {
  if (shape_of(array) != expected) raise(name + " has shape " + listed(shape_of(array)) + ", expected " + listed(expected));
}

Shape image_shape(const In& image, const std::string& name) {
  const Shape shape = shape_of(image);
  if (shape.size() != 3 || shape[2] != 3 || shape[0] == 0 || shape[1] == 0) {
    raise(name + " has shape " + listed(shape) + ", expected (H, W, 3) with at least one pixel");
  }
  return shape;
}

std::string index_text(std::size_t flat, const Shape& shape) {
  Shape index(shape.size());
  for (std::size_t axis = shape.size(); axis-- > 0; flat /= shape[axis]) index[axis] = flat % shape[axis];
  return listed(index);
}

const radiant::TrainingKernels& kernels_named(const std::string& instruction_set) {
  const radiant::TrainingKernels* kernels = radiant::find_training_kernels(instruction_set);
  if (!kernels) raise("instruction_set '" + instruction_set + "' is unknown or not this CPU's: see instruction_sets()");
  return *kernels;
}

[[noreturn]] void raise_values(const std::string& name, std::int64_t count, const std::string& fault, std::int64_t first, const Shape& shape) {
  raise(name + " has " + std::to_string(count) + " values that are " + fault + ", the first at index " +
        index_text(static_cast<std::size_t>(first), shape));
}

// Beyond it the square of a difference may be no number of float32.
constexpr float kMaxColour = 2e18f;

void check_values(const In& array, const std::string& name, float largest, int num_threads) {
  const std::int64_t rows = static_cast<std::int64_t>(array.shape(0)), columns = static_cast<std::int64_t>(array.size()) / rows;
  const auto found = [&](float limit) {
    const nb::gil_scoped_release unlocked;
    return radiant::find_beyond(array.data(), nullptr, rows, columns, limit, kernels_named(""), num_threads);
  };
  const radiant::Found beyond = found(largest);
  if (beyond.count == 0) return;
  const radiant::Found bad = found(FLT_MAX);
  if (bad.count) raise_values(name, bad.count, "not finite", bad.first, shape_of(array));
  raise_values(name, beyond.count, "beyond 2e18", beyond.first, shape_of(array));
}

void check_not_negative(const In& array, const std::string& name) {
  std::int64_t count = 0, first = 0;
  for (std::size_t i = array.size(); i-- > 0;)
    if (array.data()[i] < 0) ++count, first = static_cast<std::int64_t>(i);
  if (count) raise_values(name, count, "negative", first, shape_of(array));
}

// The runs of an (R,2) array, ascending and within the rows: kernels follow them unchecked.
const radiant::Run* checked_runs(const std::optional<Runs>& runs, std::size_t num_rows, const std::int32_t* steps = nullptr) {
  if (!runs) return nullptr;
  if (runs->ndim() != 2 || runs->shape(1) != 2) raise("runs has shape " + listed(shape_of(*runs)) + ", expected (R, 2)");
  std::int64_t last = 0;
  for (std::size_t i = 0; i < runs->size(); i += 2) {
    const std::int64_t begin = runs->data()[i], end = runs->data()[i + 1];
    if (begin < last || end <= begin || end > static_cast<std::int64_t>(num_rows)) {
      raise("runs has " + std::to_string(begin) + " to " + std::to_string(end) + " at index " + std::to_string(i / 2) +
            ", expected ascending rows below " + std::to_string(num_rows));
    }
    if (steps && steps[begin] < 1) raise("steps has " + std::to_string(steps[begin]) + " at index " + std::to_string(begin) + ", expected at least 1");
    last = end;
  }
  static_assert(sizeof(radiant::Run) == 2 * sizeof(std::int32_t));
  return reinterpret_cast<const radiant::Run*>(runs->data());
}

nb::ndarray<nb::numpy, std::int32_t, nb::ndim<2>> visible_runs(const Array<const bool>& visible, const Array<const std::int32_t>& steps) {
  if (visible.ndim() != 1) raise("visible has shape " + listed(shape_of(visible)) + ", expected (N,)");
  check_shape(steps, "steps", shape_of(visible));
  if (visible.size() > static_cast<std::size_t>(std::numeric_limits<std::int32_t>::max())) raise("visible has too many rows");
  auto runs = std::make_unique<std::vector<radiant::Run>>();
  {
    nb::gil_scoped_release unlocked;
    *runs = radiant::visible_runs(visible.data(), steps.data(), visible.size());
  }
  std::vector<radiant::Run>* kept = runs.release();
  nb::capsule owner(kept, [](void* pointer) noexcept { delete static_cast<std::vector<radiant::Run>*>(pointer); });
  return {reinterpret_cast<std::int32_t*>(kept->data()), {kept->size(), 2}, owner};
}

void target_statistics(const In& target, const Out& means, const Out& variances, int num_threads, const std::string& instruction_set) {
  const Shape shape = image_shape(target, "target");
  check_shape(means, "means", shape);
  check_shape(variances, "variances", shape);
  check_values(target, "target", kMaxColour, num_threads);
  const radiant::StatisticsJob job{target.data(), means.data(), variances.data(), static_cast<std::int64_t>(shape[0]),
                                   static_cast<std::int64_t>(shape[1])};
  const radiant::TrainingKernels& kernels = kernels_named(instruction_set);
  nb::gil_scoped_release unlocked;
  radiant::target_statistics(job, kernels, num_threads);
}

double training_loss(const In& image, const In& target, const In& means, const In& variances, const std::optional<In>& weights,
                     const std::optional<Out>& gradient, float ssim_weight, int num_threads, const std::string& instruction_set) {
  const Shape shape = image_shape(image, "image");
  check_shape(target, "target", shape);
  check_shape(means, "means", shape);
  check_shape(variances, "variances", shape);
  if (weights) check_shape(*weights, "weights", {shape[0], shape[1]});
  if (gradient) check_shape(*gradient, "gradient", shape);
  radiant::LossJob job{};
  job.image = image.data();
  job.target = target.data();
  job.means = means.data();
  job.variances = variances.data();
  job.weights = weights ? weights->data() : nullptr;
  job.gradient = gradient ? gradient->data() : nullptr;
  job.height = static_cast<std::int64_t>(shape[0]);
  job.width = static_cast<std::int64_t>(shape[1]);
  job.ssim_weight = ssim_weight;
  const radiant::TrainingKernels& kernels = kernels_named(instruction_set);
  radiant::LossSums sums{};
  {
    nb::gil_scoped_release unlocked;
    sums = radiant::training_loss(job, kernels, num_threads);
  }
  if (!std::isfinite(sums.loss) || !(sums.distance <= kMaxColour)) {
    check_values(image, "image", kMaxColour, num_threads);
    if (weights) check_values(*weights, "weights", FLT_MAX, num_threads);
  }
  if (sums.negative_weight) check_not_negative(*weights, "weights");
  return sums.loss;
}

void adam_step(const Out& parameters, const In& gradients, const Out& first_moments, const Out& second_moments,
               const std::optional<Runs>& runs, const std::optional<Array<const std::int32_t>>& steps,
               const In& first_factors, const In& second_factors, std::int64_t step, float rate, double beta1, double beta2, float epsilon,
               int num_threads, const std::string& instruction_set) {
  const Shape shape = shape_of(parameters);
  if (shape.empty()) raise("parameters has shape (), expected rows");
  check_shape(gradients, "gradients", shape);
  check_shape(first_moments, "first_moments", shape);
  check_shape(second_moments, "second_moments", shape);
  check_shape(second_factors, "second_factors", {first_factors.size()});
  if (steps) check_shape(*steps, "steps", {shape[0]});
  if (runs.has_value() != steps.has_value()) raise("runs and steps go together: give both or none");
  if (first_factors.size() == 0) raise("first_factors has shape (0,), expected at least one factor");
  if (step < 1) raise("step is " + std::to_string(step) + ", expected at least 1");
  if (parameters.size() == 0) return;

  radiant::AdamJob job{};
  job.parameters = parameters.data();
  job.gradients = gradients.data();
  job.first_moments = first_moments.data();
  job.second_moments = second_moments.data();
  job.runs = checked_runs(runs, shape[0], steps ? steps->data() : nullptr);
  job.steps = steps ? steps->data() : nullptr;
  job.first_factors = first_factors.data();
  job.second_factors = second_factors.data();
  job.num_factors = static_cast<std::int64_t>(first_factors.size());
  job.step = step;
  job.columns = static_cast<std::int64_t>(parameters.size() / shape[0]);
  job.rate = rate;
  job.beta2 = static_cast<float>(beta2);
  job.first_share = static_cast<float>(1 - beta1);
  job.second_share = static_cast<float>(1 - beta2);
  job.epsilon = epsilon;
  const radiant::TrainingKernels& kernels = kernels_named(instruction_set);
  nb::gil_scoped_release unlocked;
  radiant::adam_step(job, static_cast<std::int64_t>(shape[0]), runs ? static_cast<std::int64_t>(runs->shape(0)) : 0, kernels, num_threads);
}

std::vector<std::int64_t> find_not_finite(const In& values, const std::optional<Runs>& runs, int num_threads) {
  const Shape shape = shape_of(values);
  if (shape.empty()) raise("values has shape (), expected rows");
  if (values.size() == 0) return {0};
  const std::int64_t columns = static_cast<std::int64_t>(values.size() / shape[0]);
  const radiant::Run* checked = checked_runs(runs, shape[0]);
  const std::int64_t count = static_cast<std::int64_t>(runs ? runs->shape(0) : shape[0]);
  radiant::Found found{};
  {
    nb::gil_scoped_release unlocked;
    found = radiant::find_beyond(values.data(), checked, count, columns, FLT_MAX, kernels_named(""), num_threads);
  }
  if (found.count == 0) return {0};
  std::vector<std::int64_t> result(1 + shape.size());
  result[0] = found.count;
  for (std::size_t axis = shape.size(); axis-- > 0; found.first /= static_cast<std::int64_t>(shape[axis])) {
    result[1 + axis] = found.first % static_cast<std::int64_t>(shape[axis]);
  }
  return result;
}

}  // namespace

void bind_training(nb::module_& module) {
  module.def("target_statistics", &target_statistics, "target"_a, "means"_a.noconvert(), "variances"_a.noconvert(), "num_threads"_a = 1, "instruction_set"_a = "",
             "Writes blur(target) and blur(target^2) - blur(target)^2, all (H,W,3) float32; the window is that of SSIM, sigma 1.5 px.\n\n"
             "Raises ValueError naming the array for a wrong shape and for a target that is not finite or beyond 2e18 (how many, the first index).");
  module.def("training_loss", &training_loss, "image"_a, "target"_a, "means"_a, "variances"_a, "weights"_a.none(), "gradient"_a.none().noconvert(),
             "ssim_weight"_a, "num_threads"_a = 1, "instruction_set"_a = "",
             "(1 - lambda) L1 + lambda (1 - SSIM) of image and target (H,W,3) float32 with lambda = ssim_weight, each pixel weighted\n"
             "by weights (H,W) or None; `gradient` (H,W,3), where given, receives the derivative by the image.\n\n"
             "`means` and `variances` are the target's, from target_statistics. The same bits for any number of threads.\n"
             "Raises ValueError naming the array for a wrong shape, for an image or weights that are not finite or beyond 2e18, and for negative weights.");
  module.def("visible_runs", &visible_runs, "visible"_a, "steps"_a,
             "Runs (R,2) int32, begin and end, of rows where visible (N,) bool and whose count of steps (N,) int32 is equal.");
  module.def("adam_step", &adam_step, "parameters"_a.noconvert(), "gradients"_a, "first_moments"_a.noconvert(),
             "second_moments"_a.noconvert(), "runs"_a.none(),
             "steps"_a.none(), "first_factors"_a, "second_factors"_a, "step"_a, "rate"_a, "beta1"_a, "beta2"_a, "epsilon"_a,
             "num_threads"_a = 1, "instruction_set"_a = "",
             "One step of Adam on parameters (N,...) float32 and their moments, in place: on the rows of runs (R,2), each run with the\n"
             "count steps (N,) int32 of its rows, or on all rows with the count `step` where both are None.\n\n"
             "first_factors[t - 1] is 1 / (1 - beta1^t), second_factors[t - 1] is 1 / sqrt(1 - beta2^t); the last serves all later t.\n"
             "Gradients count as at most 1e18 and are not checked here: see find_not_finite. Raises ValueError naming the array for a wrong shape.");
  module.def("find_not_finite", &find_not_finite, "values"_a, "runs"_a.none(), "num_threads"_a = 1,
             "[0], or the count of NaN and infinite values (N,...) in the rows of runs (R,2), or in all,\n"
             "followed by the index of the first.");
}
