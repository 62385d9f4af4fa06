#include "delaunay_binding.hpp"

#include <algorithm>
#include <vector>

#include "delaunay_tables.hpp"

namespace nb = nanobind;

namespace lfnav {

namespace {

nb::object python_delaunay_triangles(nb::handle points, nb::handle smallest_area) {
    const ArrayArgument<double> places(points, "points", {ANY, 2});
    const double smallest = number_from(0.0, smallest_area, "smallest_area");
    const std::vector<std::int32_t> corners = LFNAV_BEST(triangulated)(places.span(), smallest);
    NewArray<std::int32_t> result({corners.size() / 3, 3});
    std::copy(corners.begin(), corners.end(), result.values.begin());
    return nb::cast(result.array);
}

nb::tuple python_delaunay_meshes(nb::handle poses, nb::handle intrinsics, nb::handle width,
                                 nb::handle height, nb::handle centres, nb::handle takes_part,
                                 nb::handle limits) {
    const ArrayArgument<double> cameras(poses, "poses", {ANY, 4, 4});
    const ArrayArgument<double> lens(intrinsics, "intrinsics", {4});
    const ArrayArgument<double> places(centres, "centres", {ANY, 3});
    const std::size_t count = cameras.shape(0), photos = places.shape(0);
    const ArrayArgument<bool> chosen(takes_part, "takes_part", {count, photos});
    const ArrayArgument<double> numbers(limits, "limits", {4});
    const MeshedViews views{cameras.data(),
                            count,
                            lens.data(),
                            integer_between(1, LONGEST_SIDE, width, "width"),
                            integer_between(1, LONGEST_SIDE, height, "height"),
                            places.data(),
                            chosen.data(),
                            photos};
    // Triangles, strips and wedges; a region without pixels is none.
    const std::size_t most = std::min(4 * photos + 8, views.width * views.height);
    NewArray<std::int32_t> of_regions({count, most, 3});
    NewArray<float> weights({count, most, 3, 4});
    NewArray<std::int32_t> regions({count, views.height, views.width});
    std::size_t largest = 0;
    {
        const nb::gil_scoped_release unlocked;
        largest = LFNAV_BEST(set_mesh_tables)(
            views, mesh_settings(numbers),
            {most, of_regions.values.data(), weights.values.data(), regions.values.data()});
    }
    return nb::make_tuple(of_regions.array, weights.array, regions.array, largest);
}

}  // namespace

MeshSettings mesh_settings(const ArrayArgument<double>& limits) {
    const double* const limit = limits.data();
    return {limit[0], limit[1], limit[2], limit[3]};
}

void bind_delaunay(nb::module_& module) {
    module.def("delaunay_triangles", &python_delaunay_triangles, argument("points"),
               argument("smallest_area"));
    module.def("delaunay_meshes", &python_delaunay_meshes, argument("poses"),
               argument("intrinsics"), argument("width"), argument("height"), argument("centres"),
               argument("takes_part"), argument("limits"));
}

}  // namespace lfnav
