// Python's functions that make depth maps.

#include <string>
#include <vector>

#include "arguments.hpp"
#include "bindings.hpp"
#include "depth_fusion.hpp"
#include "plane_sweep.hpp"
#include "semi_global_matching.hpp"

namespace nb = nanobind;

namespace lfnav::LFNAV_LEVEL {

namespace {

// Their numbers have to be exact in single precision, fractions included.
constexpr std::size_t MOST_PLANES = 1 << 16;
// Penalties are far below what bounds the planes.
constexpr double LARGEST_PENALTY = 1e6;

/// An image (H, W).
template <typename Element>
ArrayArgument<Element> image_argument(nb::handle array, const char* name) {
    const ArrayArgument<Element> image(array, name, {ANY, ANY});
    if (image.shape(0) > LONGEST_SIDE || image.shape(1) > LONGEST_SIDE) {
        refuse_value(name, "sides of at most 32768 pixels expected");
    }
    return image;
}

/// A list of images, each of which has pixels.
template <typename Element>
std::vector<ArrayArgument<Element>> images_of(nb::handle arrays, const char* name) {
    if (!nb::isinstance<nb::sequence>(arrays)) {
        refuse_type(name, "a list of arrays expected");
    }
    std::vector<ArrayArgument<Element>> result;
    for (const nb::handle array : nb::borrow<nb::sequence>(arrays)) {
        const std::string own = std::string(name) + "[" + std::to_string(result.size()) + "]";
        result.push_back(image_argument<Element>(array, own.c_str()));
        if (result.back().span().empty()) {
            refuse_value(own.c_str(), "an image without pixels");
        }
    }
    return result;
}

float penalty(nb::handle number, const char* name) {
    return static_cast<float>(number_between(0.0, LARGEST_PENALTY, number, name));
}

nb::object python_plane_sweep(nb::handle reference, nb::handle photos, nb::handle maps,
                              nb::handle inverse_depths, nb::handle best, nb::handle saturation) {
    const auto own = image_argument<std::uint8_t>(reference, "reference");
    const auto images = images_of<std::uint8_t>(photos, "photos");
    const ArrayArgument<double> mapped(maps, "maps", {images.size(), 3, 4});
    const ArrayArgument<double> planes(inverse_depths, "inverse_depths", {ANY});
    const std::size_t kept = integer_between(1, 1 << 15, best, "best");
    const auto limit = static_cast<float>(positive_number(saturation, "saturation"));
    std::vector<SweptPhoto> swept;
    swept.reserve(images.size());
    for (std::size_t i = 0; i < images.size(); ++i) {
        swept.push_back({images[i], mapped.data() + 12 * i});
    }
    NewArray<std::uint8_t> volume({own.shape(0), own.shape(1), planes.shape(0)});
    if (!volume.values.empty()) {
        const nb::gil_scoped_release unlocked;
        plane_sweep(own, swept, planes.span(), kept, limit, volume.values.data());
    }
    return nb::cast(volume.array);
}

nb::tuple python_semi_global_matching(nb::handle volume, nb::handle reference, nb::handle step,
                                      nb::handle jump, nb::handle edge_contrast,
                                      nb::handle least_jump) {
    const auto own = image_argument<std::uint8_t>(reference, "reference");
    const std::size_t height = own.shape(0), width = own.shape(1);
    const ArrayArgument<std::uint8_t> costs(volume, "volume", {height, width, ANY});
    if (costs.shape(2) < 1 || costs.shape(2) > MOST_PLANES) {
        refuse_value("volume", "from 1 to 65536 planes expected");
    }
    const DepthPenalties penalties{
        penalty(step, "step_penalty"), penalty(jump, "jump_penalty"),
        static_cast<float>(number_from(1e-6, edge_contrast, "edge_contrast")),
        penalty(least_jump, "least_jump")};
    NewArray<float> index({height, width}), distinctness({height, width});
    if (!index.values.empty()) {
        const nb::gil_scoped_release unlocked;
        semi_global_matching(costs.data(), costs.shape(2), own, penalties, index.values.data(),
                             distinctness.values.data());
    }
    return nb::make_tuple(index.array, distinctness.array);
}

nb::tuple python_fuse_depth(nb::handle inverse_depth, nb::handle others, nb::handle confident,
                            nb::handle to_view, nb::handle from_view, nb::handle unsure_trust,
                            nb::handle agreement) {
    const auto own = image_argument<float>(inverse_depth, "inverse_depth");
    const auto maps = images_of<float>(others, "others");
    const auto sure = images_of<bool>(confident, "confident");
    if (sure.size() != maps.size()) {
        refuse_value("confident", "as many as others expected");
    }
    const ArrayArgument<double> to(to_view, "to_view", {maps.size(), 3, 4});
    const ArrayArgument<double> from(from_view, "from_view", {maps.size(), 3, 4});
    std::vector<NeighbourDepth> neighbours;
    neighbours.reserve(maps.size());
    for (std::size_t i = 0; i < maps.size(); ++i) {
        if (sure[i].shape(0) != maps[i].shape(0) || sure[i].shape(1) != maps[i].shape(1)) {
            refuse_value("confident", "sizes as of others expected");
        }
        neighbours.push_back({maps[i], sure[i].data(), to.data() + 12 * i, from.data() + 12 * i});
    }
    const auto trust = static_cast<float>(number_from(0.0, unsure_trust, "unsure_trust"));
    const double share = number_from(0.0, agreement, "agreement");
    NewArray<float> fused({own.shape(0), own.shape(1)}), votes({own.shape(0), own.shape(1)});
    {
        const nb::gil_scoped_release unlocked;
        fuse_depth(own, neighbours, trust, share, fused.values.data(), votes.values.data());
    }
    return nb::make_tuple(fused.array, votes.array);
}

}  // namespace

void bind_depth(nb::module_& module) {
    module.def("plane_sweep", &python_plane_sweep, argument("reference"), argument("photos"),
               argument("maps"), argument("inverse_depths"), argument("best"),
               argument("saturation"));
    module.def("semi_global_matching", &python_semi_global_matching, argument("volume"),
               argument("reference"), argument("step_penalty"), argument("jump_penalty"),
               argument("edge_contrast"), argument("least_jump"));
    module.def("fuse_depth", &python_fuse_depth, argument("inverse_depth"), argument("others"),
               argument("confident"), argument("to_view"), argument("from_view"),
               argument("unsure_trust"), argument("agreement"));
}

}  // namespace lfnav::LFNAV_LEVEL
