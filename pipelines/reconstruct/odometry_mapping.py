"""Structure from motion that starts from odometry, for hundreds of photos; a part of the worker.

A model that is grown image by image is adjusted again and again, and things that look alike in two
rooms can fold it. Odometry knows which room it was. Its drift is taken out by the matches
(``pose_graph``), points are triangulated from these poses, and both are adjusted together (bundle
adjustment), a few times with ever stricter bounds on what fits. All photos stay in one frame.
"""

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import Float32Array, FloatArray, IntArray
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse
from pipelines.reconstruct.photo_pairs import Pairs, depth_unit, spatial_pairs
from pipelines.reconstruct.pose_graph import (
    ODOMETRY_DRIFT,
    REMAINING_DRIFT,
    Drift,
    Links,
    beside_nearest,
    correct_drift,
    walked,
)
from pipelines.reconstruct.retrieval import PossiblePairs, alike_pairs, photo_descriptors

# COLMAP's kinds of pairs that tell a direction (estimators/two_view_geometry.h).
CALIBRATED, PLANAR, PLANAR_OR_PANORAMIC = 2, 4, 6
LINK_KINDS = (CALIBRATED, PLANAR, PLANAR_OR_PANORAMIC)
# Cameras farther apart, in units of ``depth_unit``, do not recognise the same features.
ALIKE_REACH = 2.5
# Matches that a pair needs to say something of the poses.
LINK_MATCHES = 25


@dataclass(frozen=True)
class Round:
    """Bounds of one adjustment.

    Attributes:
        angle: degrees, between a point and its observation when it is triangulated.
        error: pixels, of an observation that is kept.
        loss: pixels beyond which errors count less.
    """

    angle: float
    error: float
    loss: float


ROUNDS = (Round(4.0, 16.0, 4.0), Round(2.0, 6.0, 2.0), Round(2.0, 4.0, 1.0), Round(2.0, 4.0, 1.0))
# Metres: how well the drift-corrected poses, from which the rounds start, tell a place.
PLACE_SIGMA, HEIGHT_SIGMA = 0.2, 0.03
ITERATIONS, TOLERANCE = 40, 1e-5
MIN_ANGLE = 1.5  # degrees between two rays to a point
# Photos that see fewer points than this are held where odometry puts them beside the others.
MIN_POINTS = 25
POSES = "poses.npy"


def links_in(database: Path, row_of_name: dict[str, int], compared: Pairs) -> Links:
    """What the verified pairs in COLMAP's database say of the photos' poses.

    Args:
        database: after matching.
        row_of_name: rows of the photos.
        compared: the pairs that are looked at; after a kill there may be others.
    """
    import pycolmap

    with pycolmap.Database.open(database) as opened:
        images = opened.read_all_images()
        row_of_image = {image.image_id: row_of_name[image.name] for image in images}
        numbers, geometries = opened.read_two_view_geometries()
    wanted = set(compared)
    pairs, rotations, directions = [], [], []
    for number, geometry in zip(numbers, geometries, strict=True):
        relative = geometry.cam2_from_cam1
        if relative is None or int(geometry.config) not in LINK_KINDS:
            continue
        first_from_second = relative.inverse()
        length = float(np.linalg.norm(first_from_second.translation))
        if len(geometry.inlier_matches) < LINK_MATCHES or length == 0.0:
            continue
        first, second = (row_of_image[image] for image in pycolmap.pair_id_to_image_pair(number))
        if (first, second) not in wanted:
            continue
        pairs.append([first, second])
        rotations.append(first_from_second.rotation.matrix())
        directions.append(first_from_second.translation / length)
    count = len(pairs)
    return Links(
        np.array(pairs, dtype=np.int64).reshape(count, 2),
        np.array(rotations).reshape(count, 3, 3),
        np.array(directions).reshape(count, 3),
    )


def pairs_to_compare(
    camera: Camera,
    world_from_camera: FloatArray,
    path: FloatArray,
    drift: Drift,
    descriptors: Float32Array,
) -> Pairs:
    """Pairs by sequence, by place and view, and of photos that look alike.

    Args:
        camera: that took the photos.
        world_from_camera: ``(N, 4, 4)`` in time order.
        path: ``(N,)`` metres walked.
        drift: of the poses.
        descriptors: ``(N, K)``, one a photo.
    """
    reach = ALIKE_REACH * depth_unit(world_from_camera)
    possible = PossiblePairs(world_from_camera, path, reach, drift)
    alike = alike_pairs(descriptors, possible)
    return sorted({*spatial_pairs(camera, world_from_camera), *alike})


class OdometryMapping:
    """Photos and odometry to one model.

    Args:
        database: COLMAP's, after extraction.
        images: folder of the images.
        names: of the images, in time order.
        camera: that took them.
        odometry: ``(N, 4, 4)`` world_from_camera.
        seed: of all random choices.
    """

    def __init__(
        self,
        database: Path,
        images: Path,
        names: list[str],
        camera: Camera,
        odometry: FloatArray,
        seed: int,
    ) -> None:
        self._database, self._images, self._names = database, images, names
        self._row_of_name = {name: row for row, name in enumerate(names)}
        self._camera, self._odometry, self._seed = camera, odometry, seed

    def compare(self, match: Callable[[Pairs], None]) -> FloatArray:
        """Matches the pairs that are worth it, and takes the drift out of odometry.

        The second time the pairs are chosen by the corrected poses. Pairs whose matches contradict
        the rest are removed from the database.

        Returns:
            ``(N, 4, 4)`` world_from_camera.
        """
        path = walked(self._odometry)
        reach = ALIKE_REACH * depth_unit(self._odometry)
        descriptors = photo_descriptors(self._database, self._names, self._seed)
        poses = self._odometry
        compared: set[tuple[int, int]] = set()
        for drift in (ODOMETRY_DRIFT, REMAINING_DRIFT):
            compared |= set(pairs_to_compare(self._camera, poses, path, drift, descriptors))
            match(sorted(compared))
            links = links_in(self._database, self._row_of_name, sorted(compared))
            corrected = correct_drift(self._odometry, poses, links, drift, reach)
            poses = corrected.world_from_camera
        self._remove(links.pairs[~corrected.fitting])
        return poses

    def _remove(self, pairs: IntArray) -> None:
        import pycolmap

        with pycolmap.Database.open(self._database) as opened:
            number = {image.name: image.image_id for image in opened.read_all_images()}
            for first, second in pairs.tolist():
                opened.delete_inlier_matches(
                    number[self._names[first]], number[self._names[second]]
                )

    def adjust(self, start: FloatArray, folder: Path, done: Callable[[], None]) -> Path:
        """Triangulates and adjusts in rounds, which are kept: a later call goes on after them.

        Args:
            start: ``(N, 4, 4)`` world_from_camera.
            folder: existing; each round's model comes into a subfolder.
            done: called after every round.

        Returns:
            The folder of the last model.
        """
        poses, finished = start, folder
        for number, bounds in enumerate(ROUNDS):
            finished = folder / f"round-{number}"
            if not finished.is_dir():
                model = self._triangulated(poses, bounds)
                held = self._adjusted(model, start, bounds)
                poses = beside_the_others(self._poses_of(model), start, held)
                unfinished = folder / "unfinished"
                shutil.rmtree(unfinished, ignore_errors=True)
                unfinished.mkdir()
                model.write_binary(unfinished)
                np.save(unfinished / POSES, poses)
                unfinished.rename(finished)
            poses = np.load(finished / POSES)
            done()
        return finished

    def _triangulated(self, poses: FloatArray, bounds: Round) -> Any:
        """A model of all photos at these poses, and the points that they see."""
        import pycolmap

        model = pycolmap.Reconstruction()
        with pycolmap.Database.open(self._database) as opened:
            (camera,) = opened.read_all_cameras()
            images = {image.name: image.image_id for image in opened.read_all_images()}
        model.add_camera_with_trivial_rig(camera)
        for name, camera_from_world in zip(self._names, inverse(poses), strict=True):
            image = pycolmap.Image(name=name, camera_id=camera.camera_id, image_id=images[name])
            pose = pycolmap.Rigid3d(camera_from_world[:3])
            model.add_image_with_trivial_frame(image, pose)
        options = pycolmap.IncrementalPipelineOptions()
        options.num_threads = 1
        options.random_seed = self._seed
        options.ba_global_max_refinements = 1
        options.extract_colors = False
        options.mapper.random_seed = self._seed
        options.mapper.filter_max_reproj_error = bounds.error
        options.mapper.filter_min_tri_angle = MIN_ANGLE
        options.triangulation.random_seed = self._seed
        options.triangulation.create_max_angle_error = bounds.angle
        options.triangulation.continue_max_angle_error = bounds.angle
        options.triangulation.merge_max_reproj_error = bounds.error
        options.triangulation.complete_max_reproj_error = bounds.error
        with tempfile.TemporaryDirectory() as unused:
            return pycolmap.triangulate_points(
                model, self._database, self._images, unused, options=options
            )

    def _adjusted(self, model: Any, start: FloatArray, bounds: Round) -> list[int]:
        """Adjusts poses and points of the model; returns the rows of the photos that were held.

        Parts of a model that few photos join, through a doorway, say, would turn against each
        other. So the photos' places count too, as uncertain as odometry leaves them.
        """
        import pycolmap

        options = pycolmap.BundleAdjustmentOptions()
        options.refine_focal_length = False
        options.refine_extra_params = False
        options.print_summary = False
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
        options.ceres.loss_function_scale = bounds.loss
        options.ceres.solver_options.num_threads = 1
        options.ceres.solver_options.max_num_iterations = ITERATIONS
        options.ceres.solver_options.function_tolerance = TOLERANCE
        config = pycolmap.BundleAdjustmentConfig()
        held, priors = [], []
        for number in sorted(model.reg_image_ids()):
            image = model.image(number)
            config.add_image(number)
            if image.num_points3D < MIN_POINTS:
                config.set_constant_rig_from_world_pose(image.frame_id)
                held.append(self._row_of_name[image.name])
            prior = pycolmap.PosePrior()
            prior.corr_data_id = image.data_id
            prior.position = start[self._row_of_name[image.name], :3, 3]
            prior.position_covariance = np.diag([PLACE_SIGMA, PLACE_SIGMA, HEIGHT_SIGMA]) ** 2
            prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
            priors.append(prior)
        pycolmap.create_pose_prior_bundle_adjuster(
            options, pycolmap.PosePriorBundleAdjustmentOptions(), config, priors, model
        ).solve()
        return sorted(held)

    def _poses_of(self, model: Any) -> FloatArray:
        """World_from_camera ``(N, 4, 4)`` of the model's photos."""
        poses = np.tile(np.eye(4), (len(self._names), 1, 1))
        for number in model.reg_image_ids():
            image = model.image(number)
            camera_from_world = image.cam_from_world().matrix()
            poses[self._row_of_name[image.name], :3] = camera_from_world
        return inverse(poses)


def beside_the_others(poses: FloatArray, before: FloatArray, held: list[int]) -> FloatArray:
    """Poses where the photos ``held`` lie to their neighbours in time as they lay before.

    Args:
        poses: ``(N, 4, 4)`` world_from_camera.
        before: the same photos' poses that the neighbours are taken from.
        held: rows of photos without a pose of their own.
    """
    free = np.setdiff1d(np.arange(len(poses)), held)
    if len(free) == 0:
        return poses
    placed = poses.copy()
    placed[held], _ = beside_nearest(poses[free], free, before, np.array(held, dtype=np.int64))
    return placed
