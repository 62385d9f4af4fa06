"""What lies in a folder of photos and is not taken, so that nobody misses it without a word."""

from collections.abc import Collection, Mapping
from pathlib import Path

from pipelines.artifacts.errors import InputError
from pipelines.dataset.images import IMAGE_SUFFIXES

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv")
# Photos that are not read. What cameras call their raw files differs from maker to maker.
_RAW = ("dng", "cr2", "cr3", "nef", "nrw", "arw", "orf", "rw2", "raf", "pef", "srw", "3fr", "iiq")
UNREAD_KINDS = {
    **dict.fromkeys((".heic", ".heif", ".hif"), "HEIC"),
    ".avif": "AVIF",
    ".jxl": "JPEG XL",
    **dict.fromkeys((".jp2", ".j2k", ".jpx"), "JPEG 2000"),
    **dict.fromkeys((".bmp", ".dib"), "BMP"),
    ".gif": "GIF",
    **dict.fromkeys((".ppm", ".pgm", ".pnm", ".pbm"), "PNM"),
    ".exr": "OpenEXR",
    ".psd": "Photoshop",
    **{f".{suffix}": "raw" for suffix in _RAW},
}
CONVERT = "convert them to JPEG"
HIDDEN, NO_FILE, VIDEO, BELOW, OTHER = (
    "hidden",
    "not a file",
    "video",
    "in sub-folders",
    "of other kinds",
)


def files_left_out(folder: Path, taken: Collection[str]) -> dict[str, int]:
    """How many files of a folder are not taken, by the reason.

    Args:
        folder: with photos.
        taken: names of those that are used, and of files that are no photos but read.

    Returns:
        Reason or kind -> number of files, images before others. Of hidden files and those in
        sub-folders the photos only are counted.

    Raises:
        InputError: the folder cannot be read.
    """
    counts: dict[str, int] = {}
    try:
        for entry in sorted(folder.iterdir()):
            if entry.name in taken:
                continue
            if entry.is_dir() and not is_photo_name(entry):
                below = 0 if entry.name.startswith(".") else _photos_in(entry)
                counts[BELOW] = counts.get(BELOW, 0) + below
                continue
            reason = _reason(entry)
            if reason is not None:
                counts[reason] = counts.get(reason, 0) + 1
    except OSError as error:
        raise InputError(folder, f"cannot be read ({error.strerror or error})") from error
    kinds = [kind for kind in counts if kind not in (HIDDEN, NO_FILE, VIDEO, BELOW, OTHER)]
    order = (*sorted(kinds), NO_FILE, HIDDEN, BELOW, VIDEO, OTHER)
    return {reason: counts[reason] for reason in order if counts.get(reason)}


def is_photo_name(path: Path) -> bool:
    """Whether a file of that name is a photo, be it of a kind that is read or not."""
    return path.suffix.lower() in (*IMAGE_SUFFIXES, *UNREAD_KINDS)


def left_out_text(counts: Mapping[str, int]) -> str:
    """The counts for people, and what can be done: ``"3 HEIC, 1 video"``."""
    text = ", ".join(f"{count} {reason}" for reason, count in counts.items())
    return f"{text} ({CONVERT})" if set(counts) & set(UNREAD_KINDS.values()) else text


def _reason(entry: Path) -> str | None:
    """Why a file is not taken; None where nobody would take it for a photo of the folder."""
    if entry.name.startswith("."):
        return HIDDEN if is_photo_name(entry) else None
    if not entry.is_file():
        return NO_FILE
    suffix = entry.suffix.lower()
    if suffix in VIDEO_SUFFIXES:
        return VIDEO
    return UNREAD_KINDS.get(suffix, OTHER)


def _photos_in(folder: Path) -> int:
    return sum(
        is_photo_name(entry) and not entry.name.startswith(".") and entry.is_file()
        for entry in folder.iterdir()
    )
