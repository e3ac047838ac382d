#include "plan/deal.h"

namespace radiant {
namespace {

constexpr std::size_t kCoarsest = 4;  // boxes per site on the coarsest level
constexpr double kBand = 32;         // temperatures within which a camera may change its cell first
constexpr std::size_t kStride = 2;  // levels of the tree per solution, 16 times the boxes

CameraTree tree_of_boxes(const std::vector<CameraBox>& boxes) {
  std::vector<double> positions;
  std::vector<std::int64_t> cameras;
  positions.reserve(2 * boxes.size()), cameras.reserve(boxes.size());
  for (const CameraBox& box : boxes) {
    positions.insert(positions.end(), {box.mean_x, box.mean_y});
    cameras.push_back(box.cameras);
  }
  return {positions.data(), cameras.data(), boxes.size()};
}

}  // namespace

AugmentResult deal_to_cells(const CameraTree& tree, PowerSites& sites, const std::vector<std::int64_t>& wanted,
                            const std::vector<double>& start_weights, bool warm, std::int64_t& rounds) {
  std::vector<double> weights = start_weights;
  std::size_t level = tree.levels.size() - 1;
  while (level > 0 && tree.levels[level].size() < kCoarsest * sites.size()) --level;
  for (; level > 0; level -= std::min(level, kStride)) {
    const CameraTree coarse = tree_of_boxes(tree.levels[level]);
    const SoftResult soft = fit_soft_counts(coarse, sites, wanted, weights, warm);
    weights = augment_to_counts(coarse, sites, wanted, soft.weights, kBand * soft.temperature).weights;
    rounds += soft.rounds, warm = false;
  }
  const SoftResult soft = fit_soft_counts(tree, sites, wanted, weights, warm);
  rounds += soft.rounds;
  return augment_to_counts(tree, sites, wanted, soft.weights, kBand * soft.temperature);
}

}  // namespace radiant
