// Loss, statistics, Adam, the scan for values beyond a limit and power cells on awkward sizes, for the sanitizers to watch.
#include <cfloat>
#include <cmath>
#include <cstdio>
#include <memory>
#include <random>
#include <vector>

#include "adam.h"
#include "power_cells.h"
#include "training_isa.h"
#include "training_loss.h"

namespace {

using Floats = std::vector<float>;

std::mt19937 draw(1);

Floats random_floats(std::size_t count) {
  Floats values(count);
  for (float& value : values) value = std::uniform_real_distribution<float>(0, 1)(draw);
  return values;
}

// Exact sizes, so that a read or write beyond any array is seen.
bool loss_is_finite(const radiant::TrainingKernels& kernels, int height, int width, float ssim_weight, bool weighted, int threads) {
  const std::size_t pixels = static_cast<std::size_t>(height) * static_cast<std::size_t>(width);
  const Floats image = random_floats(3 * pixels), target = random_floats(3 * pixels), weights = random_floats(pixels);
  Floats means(3 * pixels), variances(3 * pixels), gradient(3 * pixels);
  radiant::target_statistics({target.data(), means.data(), variances.data(), height, width}, kernels, threads);
  radiant::LossJob job{};
  job.image = image.data(), job.target = target.data(), job.means = means.data(), job.variances = variances.data();
  job.weights = weighted ? weights.data() : nullptr;
  job.gradient = gradient.data();
  job.height = height, job.width = width, job.ssim_weight = ssim_weight;
  return std::isfinite(radiant::training_loss(job, kernels, threads).loss) &&
         radiant::find_beyond(gradient.data(), nullptr, height, 3 * width, FLT_MAX, kernels, threads).count == 0;
}

bool adam_is_finite(const radiant::TrainingKernels& kernels, int rows, int columns, bool selective, int threads) {
  const auto count = static_cast<std::size_t>(rows), size = count * static_cast<std::size_t>(columns);
  Floats x = random_floats(size), first(size), second(size);
  const Floats gradients = random_floats(size), factors{10.0f, 5.0f};
  const std::unique_ptr<bool[]> visible(new bool[count]);
  for (std::size_t row = 0; row < count; ++row) visible[row] = draw() % 3 != 0;
  std::vector<std::int32_t> steps(count);
  for (std::int32_t& step : steps) step = 1 + static_cast<std::int32_t>(draw() % 4);
  const std::vector<radiant::Run> runs = radiant::visible_runs(visible.get(), steps.data(), count);
  radiant::AdamJob job{};
  job.parameters = x.data(), job.gradients = gradients.data(), job.first_moments = first.data(), job.second_moments = second.data();
  job.runs = selective ? runs.data() : nullptr;
  job.steps = selective ? steps.data() : nullptr;
  job.first_factors = job.second_factors = factors.data();
  job.num_factors = 2, job.step = 1, job.columns = columns;
  job.rate = 1e-2f, job.beta2 = 0.999f, job.epsilon = 1e-15f, job.first_share = 0.1f, job.second_share = 1e-3f;
  if (selective && runs.empty()) return true;
  const auto num_runs = static_cast<std::int64_t>(runs.size());
  radiant::adam_step(job, rows, num_runs, kernels, threads);
  return radiant::find_beyond(x.data(), nullptr, rows, columns, FLT_MAX, kernels, threads).count == 0 &&
         radiant::find_beyond(x.data(), job.runs, selective ? num_runs : rows, columns, FLT_MAX, kernels, threads).count == 0;
}

bool cells_are_assigned(std::size_t positions, std::size_t sites) {
  const auto doubles = [](std::size_t count) {
    const Floats values = random_floats(count);
    return std::vector<double>(values.begin(), values.end());
  };
  const std::vector<double> at = doubles(2 * positions), from = doubles(2 * sites), weights = doubles(sites);
  std::vector<std::int32_t> cells(positions);
  return radiant::assign_power_cells(at.data(), positions, from.data(), weights.data(), sites, cells.data()) == positions;
}

}  // namespace

int main() {
  int failed = cells_are_assigned(0, 1) && cells_are_assigned(100, 7) ? 0 : 1;
  for (const char* name : {"avx512", "avx2", "portable"}) {
    const radiant::TrainingKernels* kernels = radiant::find_training_kernels(name);
    if (!kernels) continue;
    for (const int height : {1, 2, 11, 70})
      for (const int width : {1, 5, 17, 40})
        for (const float ssim_weight : {0.0f, 0.2f, 1.0f})
          for (const bool weighted : {false, true}) failed += !loss_is_finite(*kernels, height, width, ssim_weight, weighted, 3);
    for (const int rows : {1, 3, 1023, 1025, 9000})
      for (const int columns : {1, 3, 45})
        for (const bool selective : {false, true}) failed += !adam_is_finite(*kernels, rows, columns, selective, 3);
  }
  if (failed) std::printf("%d cases failed\n", failed);
  return failed ? 1 : 0;
}
