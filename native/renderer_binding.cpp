#include "renderer_binding.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>

#include "array_argument.hpp"
#include "delaunay_binding.hpp"
#include "renderer.hpp"

namespace nb = nanobind;

namespace lfnav {

namespace {

/// Columns, or rows, of an image, none of which goes back.
void check_places(std::span<const std::int64_t> places, std::size_t length, const char* name) {
    std::int64_t before = 0;
    for (const std::int64_t place : places) {
        if (place < before || place >= static_cast<std::int64_t>(length)) {
            refuse_value(name, "rising numbers within the image expected");
        }
        before = place;
    }
}

/// A light field: keeps its arrays, checked once.
class PythonLightField {
  public:
    PythonLightField(nb::handle texels, nb::handle level_start, nb::handle level_size,
                     nb::handle projection, nb::handle rays, nb::handle centres, nb::handle focal,
                     nb::handle inverse_depth, nb::handle depth_start, nb::handle depth_size,
                     nb::handle pooled_depth, nb::handle pooled_start, nb::handle usable,
                     nb::handle origin, nb::handle order, nb::handle numbers, nb::handle members,
                     nb::handle blocks, nb::handle groups, nb::handle plane,
                     nb::handle depth_settings, nb::handle penalties, nb::handle most_ranked,
                     nb::handle smallest_weight, bool has_mesh, nb::handle mesh)
        : texels_(texels, "texels", {ANY, 4}),
          level_start_(level_start, "level_start", {ANY, ANY}),
          level_size_(level_size, "level_size", {photos(), levels(), 2}),
          projection_(projection, "projection", {photos(), 3, 4}),
          rays_(rays, "rays", {photos(), 3, 3}),
          centres_(centres, "centres", {photos(), 3}),
          focal_(focal, "focal", {photos()}),
          inverse_depth_(inverse_depth, "inverse_depth", {ANY}),
          depth_start_(depth_start, "depth_start", {photos()}),
          depth_size_(depth_size, "depth_size", {photos(), 2}),
          pooled_depth_(pooled_depth, "pooled_depth", {ANY}),
          pooled_start_(pooled_start, "pooled_start", {photos()}),
          usable_(usable, "usable", {photos()}),
          origin_(origin, "origin", {3}),
          order_(order, "order", {ANY}),
          numbers_(numbers, "numbers", {ranked() * PhotoIndex::PHOTO_NUMBERS}),
          members_(members, "members", {ANY}),
          blocks_(blocks, "blocks", {members_.shape(0) * PhotoIndex::PHOTO_NUMBERS}),
          groups_(groups, "groups", {group_count() * PhotoIndex::GROUP_NUMBERS}),
          plane_(plane, "plane", {4}),
          depth_settings_(depth_settings, "depth_settings", {5}),
          penalties_(penalties, "penalties", {4}),
          most_ranked_(integer_between(1, std::numeric_limits<std::int32_t>::max(), most_ranked,
                                       "most_ranked")),
          smallest_weight_(positive_number(smallest_weight, "smallest_weight")),
          has_mesh_(has_mesh),
          mesh_(mesh, "mesh", {4}) {
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
            mesh_settings(mesh_)};
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
        const auto count = static_cast<std::int64_t>(texels_.shape(0));
        for (std::size_t i = 0; i < level_start_.span().size(); ++i) {
            const std::int64_t start = level_start_.data()[i];
            const std::int64_t width = level_size_.data()[2 * i];
            const std::int64_t height = level_size_.data()[2 * i + 1];
            if (width < 1 || height < 1 || width > MOST || height > MOST) {
                refuse_value("level_size", "sides from 1 to 32768 pixels expected");
            }
            if (start < 0 || start > count || (height + 1) * width + 2 > count - start) {
                refuse_value("level_start", "a level ends beyond the texels");
            }
        }
    }

    /// Depth maps, and what is pooled of them, are within their arrays.
    void check_depth_maps() {
        constexpr std::int64_t pooling = Photos::POOLING;
        for (std::size_t photo = 0; photo < photos(); ++photo) {
            const std::int64_t width = depth_size_.data()[2 * photo];
            const std::int64_t height = depth_size_.data()[2 * photo + 1];
            if (width < 0 || width > MOST || height < 0 || height > MOST ||
                (width == 0) != (height == 0)) {
                refuse_value("depth_size", "0, or sides from 1 to 32768 pixels expected");
            }
            has_depth_ = has_depth_ || width > 0;
            const auto check = [](const ArrayArgument<float>& values, std::int64_t start,
                                  std::int64_t size, const char* name) {
                const auto count = static_cast<std::int64_t>(values.shape(0));
                if (start < 0 || start > count || size > count - start) {
                    refuse_value(name, "a depth map ends beyond the values");
                }
            };
            check(inverse_depth_, depth_start_.data()[photo], width * height, "depth_start");
            check(pooled_depth_, pooled_start_.data()[photo],
                  (width + pooling - 1) / pooling * ((height + pooling - 1) / pooling),
                  "pooled_start");
        }
        const double* const settings = depth_settings_.data();
        for (std::size_t i = 0; i < 5; ++i) {
            // The share of an image, and all else.
            if (!(settings[i] >= 0.0 && settings[i] <= (i == 3 ? 1.0 : 100.0))) {
                refuse_value("depth_settings", "numbers from 0 to 100, or 1, expected");
            }
        }
    }

    static constexpr auto MOST = static_cast<std::int64_t>(LONGEST_SIDE);

    ArrayArgument<std::uint8_t> texels_;
    ArrayArgument<std::int64_t> level_start_, level_size_;
    ArrayArgument<double> projection_, rays_, centres_, focal_;
    ArrayArgument<float> inverse_depth_;
    ArrayArgument<std::int64_t> depth_start_, depth_size_;
    ArrayArgument<float> pooled_depth_;
    ArrayArgument<std::int64_t> pooled_start_;
    ArrayArgument<bool> usable_;
    ArrayArgument<double> origin_;
    ArrayArgument<std::int32_t> order_;
    ArrayArgument<float> numbers_;
    ArrayArgument<std::int32_t> members_;
    ArrayArgument<float> blocks_, groups_;
    ArrayArgument<double> plane_, depth_settings_, penalties_;
    bool has_depth_ = false;
    std::size_t most_ranked_;
    double smallest_weight_;
    bool has_mesh_;
    ArrayArgument<double> mesh_;
};

/// Views of a light field: keeps its arrays, checked once. Python keeps the light field as long.
class PythonVirtualViews {
  public:
    PythonVirtualViews(const PythonLightField& field, nb::handle poses, nb::handle intrinsics,
                       nb::handle across, nb::handle down, nb::handle outlook_across,
                       nb::handle outlook_down, nb::handle frustum_across, nb::handle frustum_down,
                       nb::handle pixels, nb::handle width, nb::handle height, nb::handle samples,
                       nb::handle sources, nb::handle spacing)
        : field_(field),
          poses_(poses, "poses", {ANY, 4, 4}),
          intrinsics_(intrinsics, "intrinsics", {ANY}),
          across_(across, "across", {ANY}),
          down_(down, "down", {ANY}),
          outlook_across_(outlook_across, "outlook_across", {4}),
          outlook_down_(outlook_down, "outlook_down", {4}),
          frustum_across_(frustum_across, "frustum_across", {ANY}),
          frustum_down_(frustum_down, "frustum_down", {ANY}),
          pixels_(pixels, "pixels", {ANY}),
          width_(integer_between(1, LONGEST_SIDE, width, "width")),
          height_(integer_between(1, LONGEST_SIDE, height, "height")),
          sources_(sources, "sources", {count(), ANY}),
          spacing_(number_from(1.0, spacing, "spacing")),
          samples_owner_(nb::borrow(samples)) {
        const std::size_t photos = field.light_field().photos.count;
        if (!samples.is_none() && !nb::try_cast(samples, samples_)) {
            throw nb::type_error("samples: DepthSamples or None expected");
        }
        if (samples_ != nullptr && samples_->starts.size() != photos) {
            refuse_value("samples", "those of this light field expected");
        }
        check_range(sources_.span(), -1, photos, "sources");
        if (intrinsics_.shape(0) < 4) {
            refuse_value("intrinsics", "fx, fy, cx, cy expected");
        }
        if (across_.shape(0) < 2 || down_.shape(0) < 2) {
            refuse_value(across_.shape(0) < 2 ? "across" : "down", "at least two corners expected");
        }
        check_places(across_.span(), width_, "across");
        check_places(down_.span(), height_, "down");
        check_places(outlook_across_.span(), width_, "outlook_across");
        check_places(outlook_down_.span(), height_, "outlook_down");
        check_places(frustum_across_.span(), width_, "frustum_across");
        check_places(frustum_down_.span(), height_, "frustum_down");
        check_range(pixels_.span(), 0, width_ * height_, "pixels");
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
                {across_.span(), down_.span(), outlook_across_.span(), outlook_down_.span(),
                 frustum_across_.span(), frustum_down_.span()},
                pixels_.span(),
                samples_,
                sources_.data(),
                sources_.shape(1),
                spacing_};
    }

  private:
    const PythonLightField& field_;
    ArrayArgument<double> poses_, intrinsics_;
    ArrayArgument<std::int64_t> across_, down_, outlook_across_, outlook_down_, frustum_across_,
        frustum_down_;
    ArrayArgument<std::int32_t> pixels_;
    std::size_t width_, height_;
    ArrayArgument<std::int32_t> sources_;
    double spacing_;
    nb::object samples_owner_;
    const DepthSamples* samples_ = nullptr;
};

DepthSamples python_depth_samples(const PythonLightField& self, nb::handle is_source,
                                  nb::handle steps) {
    const Photos photos = self.light_field().photos;
    const ArrayArgument<bool> wanted(is_source, "is_source", {photos.count});
    const ArrayArgument<double> distances(steps, "steps", {photos.count});
    for (const double step : distances.span()) {
        if (!(step >= 1.0)) {
            refuse_value("steps", "at least 1 pixel expected");
        }
    }
    const nb::gil_scoped_release unlocked;
    return DepthSamples(photos, wanted.span(), distances.span());
}

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
    const LightField field = self.light_field();
    const VirtualViews views = self.views();
    NewArray<float> images({self.count(), self.pixels(), 4});
    NewArray<float> inverse_depths({self.count(), self.pixels()});
    {
        const nb::gil_scoped_release unlocked;
        LFNAV_BEST(render)(field, views, images.values.data(), inverse_depths.values.data());
    }
    return nb::make_tuple(images.array, inverse_depths.array);
}

/// How views are compared with a camera image: arguments of a function of Python's.
class ComparisonArgument {
  public:
    ComparisonArgument(nb::handle query, nb::handle cost, bool fit_gain, nb::handle limits,
                       nb::handle uncovered, nb::handle table, nb::handle evidence_bin)
        : query_(query, "query"),
          cost_(static_cast<Cost>(integer_between(0, 4, cost, "cost"))),
          fit_gain_(fit_gain),
          limits_(limits, "limits", {3}),
          uncovered_(uncovered, "uncovered", {4}),
          table_(table, "table", {ANY, ANY}),
          evidence_bin_(static_cast<float>(positive_number(evidence_bin, "evidence_bin"))) {
        if (cost_ != Cost::EVIDENCE) {
            return;
        }
        const MaskedImage image = query_;
        const auto rows = static_cast<float>(table_.shape(0));
        for (std::size_t i = 0; i < image.width * image.height; ++i) {
            if (!(image.data[4 * i + 3] >= 0.0F && image.data[4 * i + 3] < rows)) {
                refuse_value("query", "a row of the table expected as each pixel's last number");
            }
        }
        if (table_.shape(1) == 0) {
            refuse_value("table", "at least one bin expected");
        }
    }

    const MaskedImageArgument& query() const { return query_; }

    operator Comparison() const {
        const double *limit = limits_.data(), *of = uncovered_.data();
        return {cost_,
                query_,
                fit_gain_,
                {static_cast<float>(limit[0]), static_cast<float>(limit[1]), of[0], of[1], of[2],
                 of[3], limit[2], table_.span(), table_.shape(1), evidence_bin_}};
    }

  private:
    MaskedImageArgument query_;
    Cost cost_;
    bool fit_gain_;
    ArrayArgument<double> limits_, uncovered_;
    ArrayArgument<float> table_;
    float evidence_bin_;
};

nb::object python_costs(const PythonVirtualViews& self, nb::handle query, nb::handle cost,
                        bool fit_gain, nb::handle limits, nb::handle uncovered, nb::handle table,
                        nb::handle evidence_bin) {
    const ComparisonArgument comparison(query, cost, fit_gain, limits, uncovered, table,
                                        evidence_bin);
    const MaskedImage image = comparison.query();
    if (image.width * image.height != self.pixels()) {
        refuse_value("query", "as many pixels as are rendered expected, got " +
                                  std::to_string(image.width * image.height));
    }
    const LightField field = self.light_field();
    const VirtualViews views = self.views();
    NewArray<double> result({self.count()});
    {
        const nb::gil_scoped_release unlocked;
        LFNAV_BEST(compare_views)(field, views, comparison, result.values.data());
    }
    return nb::cast(result.array);
}

double python_image_cost(nb::handle view, nb::handle query, nb::handle cost, bool fit_gain,
                         nb::handle limits, nb::handle uncovered, nb::handle table,
                         nb::handle evidence_bin) {
    const ComparisonArgument comparison(query, cost, fit_gain, limits, uncovered, table,
                                        evidence_bin);
    const MaskedImageArgument rendered(view, "view", comparison.query());
    const MaskedImage image = rendered;
    for (std::size_t i = 0; i < image.width * image.height; ++i) {
        if (!(image.data[4 * i + 3] >= 0.0F && image.data[4 * i + 3] <= 1.0F)) {
            refuse_value("view", "0 to 1 expected as each pixel's last number");
        }
    }
    const nb::gil_scoped_release unlocked;
    return LFNAV_BEST(compare_image)(image, comparison);
}

}  // namespace

void bind_renderer(nb::module_& module) {
    module.def("image_cost", &python_image_cost, argument("view"), argument("query"),
               argument("cost"), nb::arg("fit_gain"), argument("limits"), argument("uncovered"),
               argument("table"), argument("evidence_bin"));
    nb::class_<DepthSamples>(module, "DepthSamples").def("count", [](const DepthSamples& self) {
        return self.count;
    });
    nb::class_<PythonLightField>(module, "LightField")
        .def(nb::init<nb::handle, nb::handle, nb::handle, nb::handle, nb::handle, nb::handle,
                      nb::handle, nb::handle, nb::handle, nb::handle, nb::handle, nb::handle,
                      nb::handle, nb::handle, nb::handle, nb::handle, nb::handle, nb::handle,
                      nb::handle, nb::handle, nb::handle, nb::handle, nb::handle, nb::handle, bool,
                      nb::handle>(),
             nb::kw_only(), argument("texels"), argument("level_start"), argument("level_size"),
             argument("projection"), argument("rays"), argument("centres"), argument("focal"),
             argument("inverse_depth"), argument("depth_start"), argument("depth_size"),
             argument("pooled_depth"), argument("pooled_start"), argument("usable"),
             argument("origin"), argument("order"), argument("numbers"), argument("members"),
             argument("blocks"), argument("groups"), argument("plane"), argument("depth_settings"),
             argument("penalties"), argument("most_ranked"), argument("smallest_weight"),
             nb::arg("has_mesh"), argument("mesh"))
        .def("depth_samples", &python_depth_samples, argument("is_source"), argument("steps"))
        .def("sources", &python_sources, argument("poses"), argument("usual_inverse_depth"),
             argument("turn_cost"), argument("most"))
        .def(
            "views",
            [](const PythonLightField& self, nb::handle poses, nb::handle intrinsics,
               nb::handle across, nb::handle down, nb::handle outlook_across,
               nb::handle outlook_down, nb::handle frustum_across, nb::handle frustum_down,
               nb::handle pixels, nb::handle width, nb::handle height, nb::handle samples,
               nb::handle sources, nb::handle spacing) {
                return PythonVirtualViews(self, poses, intrinsics, across, down, outlook_across,
                                          outlook_down, frustum_across, frustum_down, pixels, width,
                                          height, samples, sources, spacing);
            },
            nb::keep_alive<0, 1>(), argument("poses"), argument("intrinsics"), argument("across"),
            argument("down"), argument("outlook_across"), argument("outlook_down"),
            argument("frustum_across"), argument("frustum_down"), argument("pixels"),
            argument("width"), argument("height"), argument("samples"), argument("sources"),
            argument("spacing"));
    nb::class_<PythonVirtualViews>(module, "VirtualViews")
        .def("render", &python_render)
        .def("costs", &python_costs, argument("query"), argument("cost"), nb::arg("fit_gain"),
             argument("limits"), argument("uncovered"), argument("table"),
             argument("evidence_bin"));
}

}  // namespace lfnav
