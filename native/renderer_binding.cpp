// Python's LightField and VirtualViews, and image_cost.

#include "renderer.hpp"

#include <algorithm>
#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <string>

#include "arguments.hpp"
#include "bindings.hpp"
#include "comparison.hpp"
#include "source_views.hpp"

namespace nb = nanobind;

namespace lfnav::LFNAV_LEVEL {

namespace {

/// A light field: keeps its arrays, checked once.
class PythonLightField {
  public:
    explicit PythonLightField(const nb::kwargs& arguments) : given_(arguments) {
        given_.end();
        check_levels();
        check_depth_maps();
        check_range(order_.span(), 0, photos(), "order");
        check_range(members_.span(), -1, ranked(), "members");
        if (members_.shape(0) % PhotoIndex::GROUP_PHOTOS != 0) {
            refuse_value("members", "groups of 16 expected");
        }
    }

    LightField light_field() const {
        const double *const penalty = penalties_.data(), *const depth = depth_settings_.data();
        const auto number = [&](std::size_t i) { return static_cast<float>(penalty[i]); };
        return {
            {photos(), levels(), texels_.data(), level_start_.data(), level_size_.data(),
             projection_.data(), centres_.data(), focal_.data(), usable_.data(), rays_.data(),
             inverse_depth_.data(), depth_start_.data(), depth_size_.data(), pooled_depth_.data(),
             pooled_start_.data(), has_depth_, static_cast<float>(depth[4])},
            {ranked(), group_count(), origin_.data(), order_.data(), numbers_.data(),
             members_.data(), blocks_.data(), groups_.data()},
            plane_.data(),
            {static_cast<float>(depth[0]), static_cast<std::int32_t>(depth[1]),
             static_cast<float>(depth[2]), depth[3]},
            {number(0), number(1), number(2), number(3)},
            most_ranked_,
            static_cast<float>(smallest_weight_),
            has_mesh_,
            MeshSettings::of(mesh_.data())};
    }

  private:
    std::size_t photos() const { return level_start_.shape(0); }
    std::size_t levels() const { return level_start_.shape(1); }
    std::size_t ranked() const { return order_.shape(0); }
    std::size_t group_count() const { return members_.shape(0) / PhotoIndex::GROUP_PHOTOS; }

    /// Each level's texels, one to the right of the last and a row below are there.
    void check_levels() const {
        if (levels() < 1 || levels() > 32) {
            refuse_value("level_start", "from 1 to 32 levels expected");
        }
        check_range(level_size_.span(), 1, LONGEST_SIDE + 1, "level_size");
        for (std::size_t i = 0; i < level_start_.span().size(); ++i) {
            const std::int64_t width = level_size_.data()[2 * i];
            const std::int64_t height = level_size_.data()[2 * i + 1];
            check_part(level_start_.data()[i], (height + 1) * width + 2, texels_.shape(0),
                       "level_start");
        }
    }

    /// Depth maps, and what is pooled of them, are within their arrays.
    void check_depth_maps() {
        constexpr std::int64_t pooling = Photos::POOLING;
        check_range(depth_size_.span(), 0, LONGEST_SIDE + 1, "depth_size");
        for (std::size_t photo = 0; photo < photos(); ++photo) {
            const std::int64_t width = depth_size_.data()[2 * photo];
            const std::int64_t height = depth_size_.data()[2 * photo + 1];
            if ((width == 0) != (height == 0)) {
                refuse_value("depth_size", "two sides or none expected");
            }
            has_depth_ = has_depth_ || width > 0;
            check_part(depth_start_.data()[photo], width * height, inverse_depth_.shape(0),
                       "depth_start");
            check_part(pooled_start_.data()[photo],
                       (width + pooling - 1) / pooling * ((height + pooling - 1) / pooling),
                       pooled_depth_.shape(0), "pooled_start");
        }
        const double* const settings = depth_settings_.data();
        for (std::size_t i = 0; i < 5; ++i) {
            // The share of an image, and all else.
            if (!(settings[i] >= 0.0 && settings[i] <= (i == 3 ? 1.0 : 100.0))) {
                refuse_value("depth_settings", "numbers from 0 to 100, or 1, expected");
            }
        }
    }

    /// Whether so many elements from a start on are within an array of a length.
    static void check_part(std::int64_t start, std::int64_t size, std::size_t length,
                           const char* name) {
        const auto count = static_cast<std::int64_t>(length);
        if (start < 0 || start > count || size > count - start) {
            refuse_value(name, "an image or depth map ends beyond the array");
        }
    }

    NamedArguments given_;
    ArrayArgument<std::uint8_t> texels_{given_, "texels", {ANY, 4}};
    ArrayArgument<std::int64_t> level_start_{given_, "level_start", {ANY, ANY}};
    ArrayArgument<std::int64_t> level_size_{given_, "level_size", {photos(), levels(), 2}};
    ArrayArgument<double> projection_{given_, "projection", {photos(), 3, 4}};
    ArrayArgument<double> rays_{given_, "rays", {photos(), 3, 3}};
    ArrayArgument<double> centres_{given_, "centres", {photos(), 3}};
    ArrayArgument<double> focal_{given_, "focal", {photos()}};
    ArrayArgument<float> inverse_depth_{given_, "inverse_depth", {ANY}};
    ArrayArgument<std::int64_t> depth_start_{given_, "depth_start", {photos()}};
    ArrayArgument<std::int64_t> depth_size_{given_, "depth_size", {photos(), 2}};
    ArrayArgument<float> pooled_depth_{given_, "pooled_depth", {ANY}};
    ArrayArgument<std::int64_t> pooled_start_{given_, "pooled_start", {photos()}};
    ArrayArgument<bool> usable_{given_, "usable", {photos()}};
    ArrayArgument<double> origin_{given_, "origin", {3}};
    ArrayArgument<std::int32_t> order_{given_, "order", {ANY}};
    ArrayArgument<float> numbers_{given_, "numbers", {ranked() * PhotoIndex::PHOTO_NUMBERS}};
    ArrayArgument<std::int32_t> members_{given_, "members", {ANY}};
    ArrayArgument<float> blocks_{given_, "blocks", {members_.shape(0) * PhotoIndex::PHOTO_NUMBERS}};
    ArrayArgument<float> groups_{given_, "groups", {group_count() * PhotoIndex::GROUP_NUMBERS}};
    ArrayArgument<double> plane_{given_, "plane", {4}};
    ArrayArgument<double> depth_settings_{given_, "depth_settings", {5}};
    ArrayArgument<double> penalties_{given_, "penalties", {4}};
    std::size_t most_ranked_ = integer_between(1, std::numeric_limits<std::int32_t>::max(),
                                               given_.take("most_ranked"), "most_ranked");
    double smallest_weight_ = positive_number(given_.take("smallest_weight"), "smallest_weight");
    bool has_mesh_ = truth(given_.take("has_mesh"), "has_mesh");
    ArrayArgument<double> mesh_{given_, "mesh", {4}};
    bool has_depth_ = false;
};

/// DepthSamples of Python's: keeps its arrays, checked once.
class PythonDepthSamples {
  public:
    PythonDepthSamples(const nb::tuple& arrays, std::size_t photos)
        : values_(arrays[0], "samples", {ANY, 3, DepthSamples::BATCH}),
          boxes_(arrays[1], "samples", {6, ANY}),
          starts_(arrays[2], "samples", {ANY}),
          ends_(arrays[3], "samples", {starts_.shape(0)}) {
        if (starts_.shape(0) != photos) {
            refuse_value("samples", "those of this light field expected");
        }
        const std::size_t batches = values_.shape(0);
        check_range(starts_.span(), 0, batches + 1, "samples");
        check_range(ends_.span(), 0, batches + 1, "samples");
        if (boxes_.shape(1) < batches + DepthSamples::BATCHES) {
            refuse_value("samples", "boxes of 16 batches more than there are expected");
        }
    }

    DepthSamples samples() const {
        return {starts_.span(), ends_.span(), values_.data(), boxes_.data(), boxes_.shape(1)};
    }

    static std::optional<PythonDepthSamples> of(nb::handle given, std::size_t photos) {
        if (given.is_none()) {
            return std::nullopt;
        }
        if (!nb::isinstance<nb::tuple>(given) || nb::len(given) != 4) {
            refuse_type("samples", "DepthSamples or None expected");
        }
        return PythonDepthSamples(nb::borrow<nb::tuple>(given), photos);
    }

  private:
    ArrayArgument<float> values_, boxes_;
    ArrayArgument<std::int64_t> starts_, ends_;
};

/// Columns, or rows, of an image, none of which goes back.
class PlacesArgument {
  public:
    PlacesArgument(NamedArguments& given, const char* name, std::size_t count, std::size_t length)
        : places_(given, name, {count}) {
        check_range(places_.span(), 0, length, name);
        if (places_.shape(0) < 2 || !std::ranges::is_sorted(places_.span())) {
            refuse_value(name, "two rising numbers or more expected");
        }
    }

    std::span<const std::int64_t> span() const { return places_.span(); }

  private:
    ArrayArgument<std::int64_t> places_;
};

/// Views of a light field: keeps its arrays, checked once. Python keeps the light field as long.
class PythonVirtualViews {
  public:
    PythonVirtualViews(const PythonLightField& field, const nb::kwargs& arguments)
        : field_(field), given_(arguments) {
        given_.end();
        check_range(sources_.span(), -1, photos(), "sources");
        check_range(pixels_.span(), 0, width_ * height_, "pixels");
        if (std::ranges::adjacent_find(pixels_.span(), std::greater_equal()) !=
            pixels_.span().end()) {
            refuse_value("pixels", "rising numbers expected");
        }
        if (intrinsics_.shape(0) < 4) {
            refuse_value("intrinsics", "fx, fy, cx, cy expected");
        }
    }

    std::size_t count() const { return poses_.shape(0); }
    std::size_t pixels() const { return pixels_.shape(0); }
    LightField light_field() const { return field_.light_field(); }

    VirtualViews views() const {
        return {poses_.data(),
                count(),
                intrinsics_.data(),
                width_,
                height_,
                {across_.span(), down_.span(), probes_across_.span(), probes_down_.span(),
                 frustum_across_.span(), frustum_down_.span()},
                pixels_.span(),
                samples_ ? std::optional(samples_->samples()) : std::nullopt,
                sources_.data(),
                sources_.shape(1),
                spacing_};
    }

  private:
    std::size_t photos() const { return field_.light_field().photos.count; }

    const PythonLightField& field_;
    NamedArguments given_;
    ArrayArgument<double> poses_{given_, "poses", {ANY, 4, 4}};
    ArrayArgument<double> intrinsics_{given_, "intrinsics", {ANY}};
    std::size_t width_ = integer_between(1, LONGEST_SIDE, given_.take("width"), "width");
    std::size_t height_ = integer_between(1, LONGEST_SIDE, given_.take("height"), "height");
    PlacesArgument across_{given_, "across", ANY, width_};
    PlacesArgument down_{given_, "down", ANY, height_};
    PlacesArgument probes_across_{given_, "probes_across", 4, width_};
    PlacesArgument probes_down_{given_, "probes_down", 4, height_};
    PlacesArgument frustum_across_{given_, "frustum_across", ANY, width_};
    PlacesArgument frustum_down_{given_, "frustum_down", ANY, height_};
    ArrayArgument<std::int32_t> pixels_{given_, "pixels", {ANY}};
    std::optional<PythonDepthSamples> samples_ =
        PythonDepthSamples::of(given_.take("samples"), photos());
    ArrayArgument<std::int32_t> sources_{given_, "sources", {count(), ANY}};
    double spacing_ = number_from(1.0, given_.take("spacing"), "spacing");
};

nb::object python_sources(const PythonLightField& self, nb::handle poses,
                          nb::handle usual_inverse_depth, nb::handle turn_cost, nb::handle most) {
    const ArrayArgument<double> cameras(poses, "poses", {ANY, 4, 4});
    const double near = number_from(0.0, usual_inverse_depth, "usual_inverse_depth");
    const double turn = number_from(0.0, turn_cost, "turn_cost");
    const std::size_t count = integer_between(1, 1 << 15, most, "most");
    NewArray<std::int32_t> sources({cameras.shape(0), count});
    {
        const nb::gil_scoped_release unlocked;
        for (std::size_t i = 0; i < cameras.shape(0); ++i) {
            choose_sources(self.light_field().photos, cameras.data() + 16 * i, near, turn,
                           sources.values.subspan(count * i, count));
        }
    }
    return nb::cast(sources.array);
}

nb::tuple python_render(const PythonVirtualViews& self) {
    NewArray<float> images({self.count(), self.pixels(), 4});
    NewArray<float> inverse_depths({self.count(), self.pixels()});
    {
        const nb::gil_scoped_release unlocked;
        render(self.light_field(), self.views(), images.values.data(),
               inverse_depths.values.data());
    }
    return nb::make_tuple(images.array, inverse_depths.array);
}

/// How views are compared with a camera image: keeps its arrays, checked.
class ComparisonArgument {
  public:
    explicit ComparisonArgument(NamedArguments& given) : given_(given) {
        given.end();
        if (cost_ != Cost::EVIDENCE) {
            return;
        }
        const auto rows = static_cast<float>(table_.shape(0));
        for (std::size_t i = 3; i < query_.span().size(); i += 4) {
            if (!(query_.data()[i] >= 0.0F && query_.data()[i] < rows)) {
                refuse_value("query", "a row of the table expected as each pixel's last number");
            }
        }
        if (table_.shape(1) == 0) {
            refuse_value("table", "at least one bin expected");
        }
    }

    std::size_t height() const { return query_.shape(0); }
    std::size_t width() const { return query_.shape(1); }

    operator Comparison() const {
        const double *limit = limits_.data(), *of = uncovered_.data();
        return {
            cost_,
            query_,
            fit_gain_,
            {static_cast<float>(limit[0]), static_cast<float>(limit[1]), of[0], of[1], of[2], of[3],
             limit[2], table_.span(), table_.shape(1), static_cast<float>(evidence_bin_)}};
    }

  private:
    NamedArguments& given_;
    ArrayArgument<float> query_{given_, "query", {ANY, ANY, 4}};
    Cost cost_ = static_cast<Cost>(integer_between(0, 4, given_.take("cost"), "cost"));
    bool fit_gain_ = truth(given_.take("fit_gain"), "fit_gain");
    ArrayArgument<double> limits_{given_, "limits", {3}};
    ArrayArgument<double> uncovered_{given_, "uncovered", {4}};
    ArrayArgument<float> table_{given_, "table", {ANY, ANY}};
    double evidence_bin_ = positive_number(given_.take("evidence_bin"), "evidence_bin");
};

nb::object python_costs(const PythonVirtualViews& self, const nb::kwargs& arguments) {
    NamedArguments given(arguments);
    const ComparisonArgument comparison(given);
    if (comparison.width() * comparison.height() != self.pixels()) {
        refuse_value("query", "as many pixels as are rendered expected, got " +
                                  std::to_string(comparison.width() * comparison.height()));
    }
    NewArray<double> result({self.count()});
    {
        const nb::gil_scoped_release unlocked;
        compare_views(self.light_field(), self.views(), comparison, result.values.data());
    }
    return nb::cast(result.array);
}

double python_image_cost(const nb::kwargs& arguments) {
    NamedArguments given(arguments);
    const nb::object view = given.take("view");
    const ComparisonArgument comparison(given);
    const ArrayArgument<float> rendered(view, "view", {comparison.height(), comparison.width(), 4});
    for (std::size_t i = 3; i < rendered.span().size(); i += 4) {
        if (!(rendered.data()[i] >= 0.0F && rendered.data()[i] <= 1.0F)) {
            refuse_value("view", "0 to 1 expected as each pixel's last number");
        }
    }
    const nb::gil_scoped_release unlocked;
    return compare(rendered, comparison);
}

}  // namespace

void bind_renderer(nb::module_& module) {
    module.def("image_cost", &python_image_cost);
    nb::class_<PythonLightField>(module, "LightField")
        .def(nb::init<const nb::kwargs&>())
        .def("sources", &python_sources, argument("poses"), argument("usual_inverse_depth"),
             argument("turn_cost"), argument("most"))
        .def(
            "views",
            [](const PythonLightField& self, const nb::kwargs& arguments) {
                return PythonVirtualViews(self, arguments);
            },
            nb::keep_alive<0, 1>());
    nb::class_<PythonVirtualViews>(module, "VirtualViews")
        .def("render", &python_render)
        .def("costs", &python_costs);
}

}  // namespace lfnav::LFNAV_LEVEL
