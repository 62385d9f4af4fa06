"""How far a run's estimates, and odometry alone, are from the truth.

Errors are the distance of the positions in metres, and the angle between the orientations in
degrees (for a robot on the floor, between the headings). A run succeeds where both, averaged over
its last frames, are small enough to dock from.
No alignment is done: the scene model's world and the ground truth's are the same. Odometry knows no
world, so its first pose is put where the truth's is.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arguments import checked_instance
from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.geometry.interpolation import MAX_GAP
from pipelines.geometry.trajectory import Trajectory, read_tum
from pipelines.localize.area_evaluation import AreaEvaluation, evaluate_areas
from pipelines.localize.consistency import (
    Consistency,
    consistency_of,
    frames_to_recover,
    frames_until_converged,
)
from pipelines.localize.description import unit_of
from pipelines.localize.run import PNP_ESTIMATE, STAND_INS, Run, load_run
from pipelines.localize.state_space import StateSpace, known_states, state_errors
from pipelines.localize.true_states import true_states
from pipelines.localize.trust import Trust, trust_of

LAST_FRAMES = 5
SUCCESS_POSITION_M = 0.15
SUCCESS_HEADING_DEG = 3.0
_COLUMNS = ("median", "rmse", "max", "last", "last5_mean")


@dataclass(frozen=True)
class ErrorStatistics:
    """One kind of error over the frames of a run.

    Statistics are of the known errors.

    Attributes:
        per_frame: ``(N,)``, NaN where there is no truth or no estimate.
    """

    per_frame: FloatArray

    @property
    def known(self) -> FloatArray:
        """The errors that are known, in order of time; there is at least one."""
        return self.per_frame[np.isfinite(self.per_frame)]

    @property
    def median(self) -> float:
        """The median."""
        return float(np.median(self.known))

    @property
    def rmse(self) -> float:
        """Root of the mean square."""
        return float(np.sqrt(np.mean(self.known**2)))

    @property
    def max(self) -> float:
        """The largest."""
        return float(np.max(self.known))

    @property
    def last(self) -> float:
        """The error in the last frame that has one."""
        return float(self.known[-1])

    @property
    def last5_mean(self) -> float:
        """Mean over the last five frames (over all of them where there are fewer)."""
        return float(np.mean(self.known[-LAST_FRAMES:]))

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; unknown errors are null."""
        figures: dict[str, Any] = {name: getattr(self, name) for name in _COLUMNS}
        figures["per_frame"] = [
            float(error) if np.isfinite(error) else None for error in self.per_frame
        ]
        return figures


@dataclass(frozen=True)
class TrackEvaluation:
    """Errors of one track, the estimate's or odometry's.

    Attributes:
        position_error_m: metres.
        heading_error_deg: degrees, in [0, 180].
        success: the last five frames that have a truth all have an estimate, and on average it is
            within 0.15 m and 3 degrees.
    """

    position_error_m: ErrorStatistics
    heading_error_deg: ErrorStatistics
    success: bool

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "position_error_m": self.position_error_m.to_dict(),
            "heading_error_deg": self.heading_error_deg.to_dict(),
            "success": self.success,
        }

    def rows(self, label: str, unit: str = "m") -> list[tuple[str, ...]]:
        """Two rows for a table with the columns of the statistics."""
        position, heading = self.position_error_m, self.heading_error_deg
        return [
            (
                f"{label}: position ({unit})",
                *(f"{getattr(position, name):.3f}" for name in _COLUMNS),
            ),
            (f"{label}: heading (deg)", *(f"{getattr(heading, name):.2f}" for name in _COLUMNS)),
        ]


@dataclass(frozen=True)
class PnpEvaluation:
    """How the pose by features did on the same frames.

    Attributes:
        errors: where it has a pose; None where none of those has a truth.
        frames_with_pose: number of frames with a pose.
        frames: number of frames of the run.
        seconds_per_frame: mean wall time of features, matches and pose.
    """

    errors: TrackEvaluation | None
    frames_with_pose: int
    frames: int
    seconds_per_frame: float

    def rows(self) -> list[tuple[str, ...]]:
        """Rows for people, but for those of the errors."""
        share = 100.0 * self.frames_with_pose / self.frames
        text = f"{self.frames_with_pose} of {self.frames} ({share:.0f} %)"
        return [
            ("frames with a pose, pnp", text),
            ("seconds a frame, pnp", f"{self.seconds_per_frame:.3f}"),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "errors": None if self.errors is None else self.errors.to_dict(),
            "frames_with_pose": self.frames_with_pose,
            "share_with_pose": self.frames_with_pose / self.frames,
            "seconds_per_frame": self.seconds_per_frame,
        }


@dataclass(frozen=True)
class RunEvaluation:
    """A ``Summary`` of how well a run went.

    Attributes:
        estimate: which of the run's estimates was judged.
        errors: of that estimate.
        odometry: of odometry alone; None where the run has none.
        pnp: of the pose by features; None where nobody asked for it.
        frames: how many frames have a truth.
        frames_without_groundtruth: how many have none, and count for nothing.
        frames_without_estimate: how many have a truth, but the filter gave no estimate.
        frames_with_stand_in: how many lack the estimate that was judged, and are judged by its
            coarser fallback.
        frames_until_converged: how many frames came before the estimate was, and stayed, good
            enough for success; None where it never was.
        frames_to_recover: length of every stretch of worse frames between good ones.
        consistency: errors after convergence compared with the stated covariances, or None.
        trust: status and confidence of the frames compared with the truth.
        particles: number of particles in the last frame.
        seconds_per_frame: mean wall time, all stages together, without PnP where that only ran
            beside the filter.
        areas: the belief over areas compared with the truth; None: the run was made with one scene.
        unit: of lengths, that of the scene.
    """

    estimate: str
    errors: TrackEvaluation
    odometry: TrackEvaluation | None
    pnp: PnpEvaluation | None
    frames: int
    frames_without_groundtruth: int
    frames_without_estimate: int
    frames_with_stand_in: int
    frames_until_converged: int | None
    frames_to_recover: tuple[int, ...]
    consistency: Consistency | None
    trust: Trust
    particles: int
    seconds_per_frame: float
    areas: AreaEvaluation | None = None
    unit: str = "m"

    @property
    def success(self) -> bool:
        """Whether the estimate succeeded."""
        return self.errors.success

    @property
    def _pnp_errors(self) -> TrackEvaluation | None:
        """Errors of PnP where they are not the estimate's."""
        if self.pnp is None or self.estimate == PNP_ESTIMATE:
            return None
        return self.pnp.errors

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        headings = ("median", "RMSE", "max", "last", f"last {LAST_FRAMES} mean")
        frames = str(self.frames)
        if self.frames_without_groundtruth:
            frames += f" (and {self.frames_without_groundtruth} without ground truth)"
        rows = [("error", *headings), *self.errors.rows(f"estimate ({self.estimate})", self.unit)]
        if self.odometry is not None:
            rows += self.odometry.rows("odometry alone", self.unit)
        if self._pnp_errors is not None:
            rows += self._pnp_errors.rows("pnp", self.unit)
        rows.append(("success, estimate", _yes_or_no(self.success)))
        if self.odometry is not None:
            rows.append(("success, odometry alone", _yes_or_no(self.odometry.success)))
        if self._pnp_errors is not None:
            rows.append(("success, pnp", _yes_or_no(self._pnp_errors.success)))
        rows.append(("frames", frames))
        if self.frames_without_estimate:
            rows.append(("frames without an estimate", str(self.frames_without_estimate)))
        if self.pnp is not None:
            rows += self.pnp.rows()
        if self.frames_with_stand_in:
            count = str(self.frames_with_stand_in)
            rows.append((f"frames where {STAND_INS[self.estimate]} stands in", count))
        converged = self.frames_until_converged
        rows.append(("frames until converged", "never" if converged is None else str(converged)))
        if self.frames_to_recover:
            lengths = ", ".join(map(str, self.frames_to_recover))
            rows.append(("frames to recover, each time", lengths))
        if self.consistency is not None:
            rows += self.consistency.rows()
        rows += self.trust.rows()
        if self.areas is not None:
            rows += self.areas.rows()
        rows.append(("particles in the last frame", str(self.particles)))
        rows.append(("seconds a frame", f"{self.seconds_per_frame:.3f}"))
        return rows

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "estimate": self.estimate,
            **self.errors.to_dict(),
            "odometry": None if self.odometry is None else self.odometry.to_dict(),
            "pnp": None if self.pnp is None else self.pnp.to_dict(),
            "frames": self.frames,
            "frames_without_groundtruth": self.frames_without_groundtruth,
            "frames_without_estimate": self.frames_without_estimate,
            "frames_with_stand_in": self.frames_with_stand_in,
            "frames_until_converged": self.frames_until_converged,
            "frames_to_recover": list(self.frames_to_recover),
            "consistency": None if self.consistency is None else self.consistency.to_dict(),
            "trust": self.trust.to_dict(),
            "particles": self.particles,
            "seconds_per_frame": self.seconds_per_frame,
            **({} if self.areas is None else {"areas": self.areas.to_dict()}),
        }


def evaluate_run_file(
    run_path: Path,
    groundtruth_path: Path | None = None,
    estimate: str | None = None,
    max_gap: float = MAX_GAP,
) -> RunEvaluation:
    """Evaluates a run file, against a TUM file or the ground truth that it carries itself.

    Arguments are those of ``evaluate_run``.

    Raises:
        InputError: a file that cannot be used, no ground truth anywhere, or none that pairs.
        OptionError: the run has no estimate of this name.
    """
    run = load_run(run_path)
    groundtruth = None if groundtruth_path is None else read_tum(groundtruth_path)
    return evaluate_run(
        run,
        groundtruth,
        estimate,
        run_path=run_path,
        groundtruth_path=groundtruth_path,
        max_gap=max_gap,
    )


def evaluate_run(
    run: Run,
    groundtruth: Trajectory | None = None,
    estimate: str | None = None,
    *,
    run_path: Path | str = "run",
    groundtruth_path: Path | str | None = None,
    max_gap: float = MAX_GAP,
) -> RunEvaluation:
    """Compares a run's estimates, and its odometry, with the truth.

    Args:
        run: the run.
        groundtruth: world_from_base, paired to the frames by time; None for the run's own.
        estimate: which estimate; None for the run's default.
        run_path: how errors name the run.
        groundtruth_path: how errors name the ground truth; None: so.
        max_gap: seconds between two poses of ``groundtruth`` between which the truth is
            interpolated, at most.

    Raises:
        InputError: no ground truth, none that pairs with a frame, or no estimate where there is.
        OptionError: the run has no estimate of this name, or an argument of another type.
    """
    checked_instance(run, "the run", Run)
    if groundtruth is not None:
        checked_instance(groundtruth, "ground truth", Trajectory)
    truth = true_states(run, groundtruth, run_path, groundtruth_path, max_gap)
    has_truth = known_states(truth)
    name = run.default_estimate if estimate is None else estimate
    estimated = run.estimated_states(estimate)
    has_estimate = known_states(estimated)
    own = np.array([name in frame.estimates for frame in run.frames])
    if not np.any(has_truth & has_estimate):
        raise InputError(run_path, f"no frame with ground truth has an estimate {quoted(name)}")
    odometry = None
    if run.odometry is not None:
        odometry = _evaluate_track(run.space, odometry_states(run, truth), truth)
    errors = _evaluate_track(run.space, estimated, truth)
    good = is_good(errors.position_error_m.per_frame, errors.heading_error_deg.per_frame)
    converged = frames_until_converged(good[has_truth])
    followed = np.zeros(len(truth), dtype=np.bool_)
    if converged is not None:
        followed[np.flatnonzero(has_truth)[converged:]] = True
    return RunEvaluation(
        estimate=name,
        errors=errors,
        odometry=odometry,
        pnp=_evaluate_pnp(run, truth),
        frames=int(np.count_nonzero(has_truth)),
        frames_without_groundtruth=int(np.count_nonzero(~has_truth)),
        frames_without_estimate=int(np.count_nonzero(has_truth & ~has_estimate)),
        frames_with_stand_in=int(np.count_nonzero(has_truth & has_estimate & ~own)),
        frames_until_converged=converged,
        frames_to_recover=tuple(frames_to_recover(good[has_truth])),
        # PnP beside the filter has no covariance in the file.
        consistency=consistency_of(run, name, truth, followed)
        if name in run.own_estimate_names
        else None,
        trust=trust_of(run, truth, estimate),
        particles=len(run.frames[-1].particles),
        seconds_per_frame=float(np.mean(run.frame_seconds)),
        areas=evaluate_areas(run, truth, estimated),
        unit=unit_of(run),
    )


def _evaluate_pnp(run: Run, truth: FloatArray) -> PnpEvaluation | None:
    if not (run.settings.get("with_pnp") or run.settings.get("method") == "pnp"):
        return None
    noted = [PNP_ESTIMATE in frame.estimates for frame in run.frames]
    errors = None
    if any(noted):
        states = run.estimated_states(PNP_ESTIMATE)
        if np.any(known_states(states) & known_states(truth)):
            errors = _evaluate_track(run.space, states, truth)
    seconds = [frame.seconds.get(PNP_ESTIMATE, 0.0) for frame in run.frames]
    return PnpEvaluation(errors, sum(noted), len(run.frames), float(np.mean(seconds)))


def odometry_states(run: Run, groundtruth: FloatArray | None = None) -> FloatArray:
    """The run's odometry in the scene's world, for display and evaluation.

    It is moved as a whole so that its first pose is the true one where the truth is known, else the
    first estimate. Where the first frame has neither, the first frame that does is used.

    Args:
        run: the run.
        groundtruth: ``(N, 3)`` true states, NaN where unknown; None for the run's own.

    Returns:
        ``(N, 3)`` x, y (metres), heading (radians).

    Raises:
        OptionError: the run has no odometry, or neither truth nor estimate in any frame.
    """
    if run.odometry is None:
        raise OptionError("the run has no odometry")
    anchors = run.groundtruth if groundtruth is None else groundtruth
    if anchors is None or not np.any(known_states(anchors)):
        anchors = run.estimated_states()
    first = int(np.flatnonzero(known_states(anchors))[0])
    poses = run.space.poses(run.odometry)
    motions = np.stack([run.space.increment(poses[first], pose) for pose in poses])
    return run.space.composed(anchors[first], motions)


def is_good(position_errors: FloatArray, heading_errors: FloatArray) -> BoolArray:
    """Which frames are good enough for success: errors ``(N,)`` in metres and degrees, NaN not."""
    small = (position_errors < SUCCESS_POSITION_M) & (heading_errors < SUCCESS_HEADING_DEG)
    return np.asarray(small, dtype=np.bool_)


def _evaluate_track(space: StateSpace, states: FloatArray, truth: FloatArray) -> TrackEvaluation:
    position_errors, angle_errors = state_errors(space, states, truth)
    position = ErrorStatistics(position_errors)
    heading = ErrorStatistics(np.degrees(angle_errors))
    # The last frames with a truth: earlier ones must not replace those without an estimate.
    last = states[known_states(truth)][-LAST_FRAMES:]
    success = (
        bool(np.all(known_states(last)))
        and position.last5_mean < SUCCESS_POSITION_M
        and heading.last5_mean < SUCCESS_HEADING_DEG
    )
    return TrackEvaluation(position, heading, success)


def _yes_or_no(value: bool) -> str:
    return "yes" if value else "no"
