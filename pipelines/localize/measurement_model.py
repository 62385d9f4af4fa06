"""The measurement model p(image | state) of the paper's equation (2), and its absolute scale.

Evidence is the logarithm of p(image | the map, seen from this state) / p(image | not the map):
positive where the image speaks for the state, 0 where the map shows nothing there, negative where
it speaks against it (``render.pixel_evidence``). It is what says whether the image shows the
map at all, whichever likelihood weighs the particles.
"""

import copy
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from pipelines.artifacts.arguments import checked_instance, checked_number
from pipelines.artifacts.arrays import BoolArray, FloatArray, checked_array
from pipelines.artifacts.errors import OptionError, quoted
from pipelines.geometry.pose import checked_poses
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import Views, views_of_scene
from pipelines.localize.alignment import Alignment, Prior, align
from pipelines.localize.belief import Belief
from pipelines.localize.likelihood import LIKELIHOODS, Likelihood
from pipelines.localize.observation import Observation, Observations
from pipelines.localize.places import compressed
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import StateSpace
from pipelines.render.channels import views_in_channels
from pipelines.render.choices import Channels, Cost, Quality
from pipelines.render.comparison import PixelEvidence
from pipelines.render.pixel_evidence import learn_evidence
from pipelines.render.renderer import Renderer
from pipelines.render.renderer_choice import renderer_of_scene
from pipelines.render.surface import quality_named
from pipelines.render.window_agreement import usual_agreement

# Photos are kept at so many times the width of the finest comparison.
VIEW_RESOLUTION_FACTOR = 8
# So many of the heaviest particles stand for a posterior.
HEAVIEST = 64
# Smallest share of an image that counts as explained: smaller ones are too noisy to compare.
LEAST_EXPLAINED = 0.1


def channels_of(likelihood: Likelihood) -> tuple[Channels, ...]:
    """The channels in which photos are compared, those of evidence among them."""
    if likelihood.cost is Cost.EVIDENCE:
        return (likelihood.channels,)
    both = {likelihood.channels, LIKELIHOODS["evidence"].channels}
    return tuple(sorted(both, key=lambda channels: channels.name))


class MeasurementModel:
    """Compares states with camera images, by the views rendered at them.

    p(image | state) of Heigl, Denzler, Niemann (2001), equation (2). From a scene: ``of_scene``.

    Args:
        colours: the photos, in colours.
        renderers: of the photos in the channels that are compared, those of evidence among them.
        space: what a state is.
        body_from_camera: ``(4, 4)`` the camera's mount.
        likelihood: how particles are weighted.
    """

    def __init__(
        self,
        colours: Views,
        renderers: dict[Channels, Renderer],
        space: StateSpace,
        body_from_camera: FloatArray,
        likelihood: Likelihood,
    ) -> None:
        self.space = space
        self.body_from_camera = body_from_camera
        self.likelihood = likelihood
        self._colours = colours
        self._renderers = renderers
        absolute = likelihood if likelihood.cost is Cost.EVIDENCE else LIKELIHOODS["evidence"]
        self._absolute = absolute
        self._learner = ThreadPoolExecutor(1)
        self._pixels: dict[int, Future[PixelEvidence]] = {}
        self._agreements: dict[int, float] = {}
        self._least_distance = _usual_distance(self.renderer, colours) / VIEW_RESOLUTION_FACTOR

    @classmethod
    def of_scene(
        cls, scene: Scene, body_from_camera: FloatArray, settings: LocalizerSettings
    ) -> "MeasurementModel":
        """The model of a scene for a filter's settings.

        Args:
            scene: the light field.
            body_from_camera: ``(4, 4)`` the camera's mount on the robot, metres; the identity where
                the camera is the body.
            settings: of the filter that will use it.

        Raises:
            OptionError: a device that is not there, a quality that needs depth maps, a mount that
                is no rigid transform, or an argument of another type.
            InputError: a photo of the scene cannot be decoded.
        """
        checked_instance(scene, "the scene", Scene)
        checked_instance(settings, "settings", LocalizerSettings)
        body_from_camera = checked_poses(body_from_camera, "body_from_camera")
        side = VIEW_RESOLUTION_FACTOR * settings.fine_width
        colours = views_of_scene(scene, side)
        quality = quality_named(settings.quality, bool(scene.depth), Quality.MEDIUM)
        likelihood = settings.likelihood
        renderers = {
            channels: renderer_of_scene(
                scene,
                side,
                settings.blending,
                quality,
                settings.threads,
                settings.device,
                views_in_channels(colours, channels),
            )
            for channels in channels_of(likelihood)
        }
        return cls(colours, renderers, settings.state_space, body_from_camera, likelihood)

    def mounted(self, body_from_camera: FloatArray) -> "MeasurementModel":
        """The same photos, and what is learnt of them, for a camera that sits elsewhere.

        Args:
            body_from_camera: ``(4, 4)`` the camera's mount on the robot, metres.

        Raises:
            OptionError: a mount that is no rigid transform.
        """
        other = copy.copy(self)
        other.body_from_camera = checked_poses(body_from_camera, "body_from_camera")
        return other

    def show(self, colours: Views, renderers: dict[Channels, Renderer]) -> None:
        """Goes on with another light field; what was learnt of pixels is kept.

        Args:
            colours: the photos, in colours.
            renderers: of the photos in the channels that are compared.
        """
        for learnt in self._pixels.values():
            # What is still being learnt is learnt from the light field of before.
            learnt.result()
        self._colours, self._renderers = colours, renderers
        self._least_distance = _usual_distance(self.renderer, colours) / VIEW_RESOLUTION_FACTOR

    @property
    def renderer(self) -> Renderer:
        """The renderer of the photos in the channels in which images are aligned and retrieved."""
        return self._renderers[self._absolute.channels]

    @property
    def channels(self) -> Channels:
        """The channels in which images are aligned and retrieved."""
        return self._absolute.channels

    def log_likelihoods(self, states: FloatArray, observation: Observation) -> FloatArray:
        """How likely an image is at states, by the settings' likelihood.

        Args:
            states: ``(M, D)`` in the world, metres and radians.
            observation: the image, as an ``Observer`` prepares it.

        Returns:
            ``(M,)`` natural logarithms, up to a common constant.

        Raises:
            OptionError: states that are not finite numbers of this shape, or no observation.
        """
        likelihood = self.likelihood
        checked_instance(observation, "observation", Observation)
        if likelihood.cost is Cost.EVIDENCE:
            return self.evidence(states, observation, likelihood.pixel_subsampling)
        own = observation.in_channels(likelihood.channels)
        costs = self._renderers[likelihood.channels].costs(
            self._poses(states),
            own.intrinsics,
            own.subsampled(likelihood.pixel_subsampling),
            likelihood.cost,
            likelihood.fit_gain,
        )
        return -likelihood.inverse_temperature * costs

    def evidence(
        self, states: FloatArray, observation: Observation, pixel_subsampling: int = 1
    ) -> FloatArray:
        """What an image says for states ``(M, D)`` against "it does not show the map", ``(M,)``.

        Args:
            states: ``(M, D)`` world_from_body, metres and radians.
            observation: the image, as an ``Observer`` prepares it.
            pixel_subsampling: one in so many pixels is compared; they stand for all.

        Returns:
            ``(M,)`` natural logarithms of likelihood ratios: positive for, negative against.

        Raises:
            OptionError: states that are not finite numbers of this shape, or no observation.
        """
        checked_instance(observation, "observation", Observation)
        checked_number(pixel_subsampling, "pixel_subsampling", 1, whole=True)
        own = observation.in_channels(self.channels)
        image = own.subsampled(pixel_subsampling)
        compared = max(int(np.count_nonzero(np.isfinite(image[..., 0]))), 1)
        usable = int(np.count_nonzero(own.used))
        costs = self.renderer.costs(
            self._poses(states),
            own.intrinsics,
            image,
            Cost.EVIDENCE,
            False,
            self.pixels(own.intrinsics.width),
        )
        # Of all pixels, masked ones included: a part of an image is worth a part.
        share = usable / compared / own.used.size
        return np.where(
            self._is_too_near(states), 0.0, -self._absolute.inverse_temperature * share * costs
        )

    def evidence_at(self, state: FloatArray, observation: Observation) -> float:
        """What an image says for one state against "it does not show the map".

        Args:
            state: ``(D,)`` world_from_body, metres and radians.
            observation: the image, as an ``Observer`` prepares it.
        """
        return float(self.evidence(state[None], observation)[0])

    def _is_too_near(self, states: FloatArray) -> BoolArray:
        """Which states ``(M, D)`` have the camera nearer to the plane than photos can show.

        There the photos have fewer pixels than the image that is compared, and what is rendered is
        blurred, whatever the scene.
        """
        renderer = self.renderer
        if renderer.quality is not Quality.PLANE or renderer.plane is None:
            return np.zeros(len(states), dtype=np.bool_)
        distances = renderer.plane.signed_distance(self._poses(states)[:, :3, 3])
        return np.asarray(distances < self._least_distance, dtype=np.bool_)

    def explained(self, state: FloatArray, observation: Observation) -> float:
        """How much of what an image says at a right pose in the map's own light it says here.

        Args:
            state: ``(D,)`` in the world, metres and radians.
            observation: the image, as an ``Observer`` prepares it.

        Returns:
            1 where the image is explained as well as the map's own photos are by each other, less
            where light or contents have changed; at most 1, and never below ``LEAST_EXPLAINED``.
        """
        state = checked_array(state, "state", (self.space.dimension,))
        return self.explained_by(self.evidence_at(state, observation), observation)

    def explained_by(self, evidence: float, observation: Observation) -> float:
        """The share that ``explained`` returns, for a state whose evidence is known.

        Args:
            evidence: of the image for the state, a natural logarithm.
            observation: the image, as an ``Observer`` prepares it.

        Raises:
            OptionError: no observation, or no number.
        """
        checked_instance(observation, "observation", Observation)
        checked_number(evidence, "evidence")
        own = observation.in_channels(self.channels)
        pixels = self.pixels(own.intrinsics.width)
        rows = pixels.rows(own.image[own.used]).astype(np.int64)
        expected = (
            self._absolute.inverse_temperature * float(pixels.expected[rows].sum()) / own.used.size
        )
        return min(max(evidence / max(expected, 1e-9), LEAST_EXPLAINED), 1.0)

    @property
    def is_absolute(self) -> bool:
        """Whether log-likelihoods are evidence."""
        return self.likelihood.cost is Cost.EVIDENCE

    def marginal_evidence(
        self, belief: Belief, log_prior: FloatArray, observation: Observation
    ) -> float:
        """What an image says for the map as a whole, from a posterior that something else made.

        The mean evidence over the posterior less its divergence from the prior; with weights that
        are prior times evidence this is the logarithm of the prior's mean of the evidence.

        Args:
            belief: the posterior.
            log_prior: ``(M,)`` log-weights of its particles before the image, normalised.
            observation: the image, as an ``Observer`` prepares it.

        Raises:
            OptionError: other types or shapes.
        """
        checked_instance(belief, "belief", Belief)
        checked_array(log_prior, "log-prior", (len(belief),), finite=False)
        heaviest = np.argsort(-belief.log_weights, kind="stable")[:HEAVIEST]
        log_weights = belief.log_weights[heaviest]
        weights = np.exp(log_weights)
        evidence = self.evidence(belief.states[heaviest], observation)
        terms = evidence + log_prior[heaviest] - log_weights
        known = np.isfinite(terms) & (weights > 0.0)
        if not known.any():
            return 0.0
        mean = float(np.sum(weights[known] * terms[known]) / np.sum(weights[known]))
        return float(compressed(mean))

    def pixels(self, width: int) -> PixelEvidence:
        """The evidence of pixel differences in images of a width; learnt once.

        Args:
            width: of the images, pixels.

        Raises:
            OptionError: no whole number of at least 1.
        """
        checked_number(width, "width", 1, whole=True)
        self.learn_pixels([width])
        return self._pixels[width].result()

    def learn_pixels(self, widths: Sequence[int]) -> None:
        """Begins to learn the evidence in images of these widths, and does not wait.

        Args:
            widths: of the images, pixels.
        """
        for width in widths:
            if width not in self._pixels:
                self._pixels[width] = self._learner.submit(
                    learn_evidence, self._colours, self.channels, width, self.renderer
                )

    def usual_agreement(self, width: int) -> float:
        """How well the map's photos agree with the views of the others; learnt once.

        Args:
            width: of the images, pixels.
        """
        if width not in self._agreements:
            self._agreements[width] = usual_agreement(
                self._colours, self.channels, width, self.renderer
            )
        return self._agreements[width]

    def aligned(
        self,
        state: FloatArray,
        observations: Observations,
        widths: Sequence[int],
        prior: Prior | None = None,
    ) -> Alignment:
        """A state aligned with an image in several sizes, coarse to fine.

        Args:
            state: ``(D,)`` where the alignment begins, in the world, metres and radians.
            observations: the image.
            widths: of its sizes, pixels.
            prior: what is known of the state before, which holds the alignment where the image says
                nothing; None: the image alone decides.

        Raises:
            OptionError: a state that is not finite numbers of this shape, or a width that the image
                was not prepared in.
        """
        state = checked_array(state, "state", (self.space.dimension,))
        for width in widths:
            if width not in checked_instance(observations, "image", Observations).by_width:
                raise OptionError(f"the image was not prepared {quoted(width)} pixels wide")
        images = [observations.by_width[width].in_channels(self.channels) for width in widths]
        return align(self.renderer, self.space, state, self.body_from_camera, images, prior=prior)

    def _poses(self, states: FloatArray) -> FloatArray:
        states = checked_array(states, "states", (None, self.space.dimension))
        return self.space.poses(states) @ self.body_from_camera


def _usual_distance(renderer: Renderer, views: Views) -> float:
    """Median distance of the views before the plane from it, metres; 0 without a plane."""
    if renderer.plane is None:
        return 0.0
    distances = renderer.plane.signed_distance(views.centres)
    return float(np.median(distances[distances > 0.0])) if np.any(distances > 0.0) else 0.0
