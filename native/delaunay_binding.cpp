// Python's delaunay_triangles and delaunay_meshes.

#include <algorithm>
#include <vector>

#include "arguments.hpp"
#include "bindings.hpp"
#include "delaunay.hpp"
#include "delaunay_tables.hpp"

namespace nb = nanobind;

namespace lfnav::LFNAV_LEVEL {

namespace {

nb::object python_delaunay_triangles(nb::handle points, nb::handle smallest_area) {
    const ArrayArgument<double> given(points, "points", {ANY, 2});
    const double smallest = number_from(0.0, smallest_area, "smallest_area");
    std::vector<Point> places;
    places.reserve(given.shape(0));
    for (std::size_t i = 0; i < given.shape(0); ++i) {
        places.push_back({given.data()[2 * i], given.data()[2 * i + 1]});
    }
    std::vector<std::int32_t> corners;
    Delaunay delaunay(smallest);
    if (delaunay(places)) {
        delaunay.for_each([&](const Delaunay::Triangle& triangle) {
            corners.insert(corners.end(), triangle.corner, triangle.corner + 3);
        });
    }
    NewArray<std::int32_t> result({corners.size() / 3, 3});
    std::copy(corners.begin(), corners.end(), result.values.begin());
    return nb::cast(result.array);
}

nb::tuple python_delaunay_meshes(const nb::kwargs& arguments) {
    NamedArguments given(arguments);
    const ArrayArgument<double> poses(given, "poses", {ANY, 4, 4});
    const ArrayArgument<double> intrinsics(given, "intrinsics", {4});
    const ArrayArgument<double> centres(given, "centres", {ANY, 3});
    const std::size_t count = poses.shape(0), photos = centres.shape(0);
    const ArrayArgument<bool> takes_part(given, "takes_part", {count, photos});
    const ArrayArgument<double> limits(given, "limits", {4});
    const MeshedViews views{poses.data(),
                            count,
                            intrinsics.data(),
                            integer_between(1, LONGEST_SIDE, given.take("width"), "width"),
                            integer_between(1, LONGEST_SIDE, given.take("height"), "height"),
                            centres.data(),
                            takes_part.data(),
                            photos};
    given.end();
    // Triangles, strips and wedges; a region without pixels is none.
    const std::size_t most = std::min(4 * photos + 8, views.width * views.height);
    NewArray<std::int32_t> of_regions({count, most, 3});
    NewArray<float> weights({count, most, 3, 4});
    NewArray<std::int32_t> regions({count, views.height, views.width});
    std::size_t largest = 0;
    {
        const nb::gil_scoped_release unlocked;
        largest = set_mesh_tables(
            views, MeshSettings::of(limits.data()),
            {most, of_regions.values.data(), weights.values.data(), regions.values.data()});
    }
    return nb::make_tuple(of_regions.array, weights.array, regions.array, largest);
}

}  // namespace

void bind_delaunay(nb::module_& module) {
    module.def("delaunay_triangles", &python_delaunay_triangles, argument("points"),
               argument("smallest_area"));
    module.def("delaunay_meshes", &python_delaunay_meshes);
}

}  // namespace lfnav::LFNAV_LEVEL
