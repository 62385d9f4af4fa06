"""Who may ask: tokens, and to which of them a request belongs."""

import hashlib
import hmac
from collections.abc import Iterable
from pathlib import Path

from pipelines.artifacts.errors import InputError, OptionError
from pipelines.artifacts.file_content import read_text_file

MAX_TOKEN_BYTES = 1024 * 1024
SHORTEST, LONGEST = 16, 512
# The owner of sessions where nobody has to say who he is.
ANYBODY = "anybody"
# How to make one, for messages.
RECIPE = "openssl rand -hex 16 makes one"


class Tokens:
    """The tokens that are accepted.

    Args:
        tokens: none: anybody may ask.
    """

    def __init__(self, tokens: Iterable[str] = ()) -> None:
        self._digests = tuple(_digest(token.encode()) for token in tokens)

    def __len__(self) -> int:
        return len(self._digests)

    def owner_of(self, header: bytes | None) -> str | None:
        """To whom a request belongs.

        It takes as long whichever token it is, and however much of one is right.

        Args:
            header: the request's ``Authorization``, ``Bearer TOKEN``; None: it has none.

        Returns:
            A name that is the same for all requests with one token; None: it has no token that is
            accepted.
        """
        if not self._digests:
            return ANYBODY
        scheme, _, token = (header or b"").partition(b" ")
        given = _digest(token.strip())
        matches = [hmac.compare_digest(given, known) for known in self._digests]
        if scheme.lower() != b"bearer" or not any(matches):
            return None
        return given.hex()


def read_token_file(path: Path) -> Tokens:
    """The tokens of a file, one a line; empty lines and those that begin with # say nothing.

    Raises:
        InputError: unreadable, without a token, or one that is too short or not plain ASCII.
    """
    lines = [line.strip() for line in read_text_file(path, MAX_TOKEN_BYTES).splitlines()]
    tokens = [line for line in lines if line and not line.startswith("#")]
    if not tokens:
        raise InputError(path, "holds no token", RECIPE)
    for number, token in enumerate(tokens, start=1):
        reason = _fault_of(token)
        if reason:
            raise InputError(path, f"token {number} {reason}", RECIPE)
    return Tokens(tokens)


def token_of_environment(name: str, text: str) -> Tokens:
    """The token that an environment variable holds.

    Args:
        name: of the variable, for errors.
        text: its value.

    Raises:
        OptionError: it is too short, or not plain ASCII.
    """
    reason = _fault_of(text.strip())
    if reason:
        raise OptionError(f"the token in {name} {reason}; {RECIPE}")
    return Tokens([text.strip()])


def _digest(token: bytes) -> bytes:
    # Of one length, whatever the token's: nothing is learnt from how long a comparison takes.
    return hashlib.sha256(token).digest()


def _fault_of(token: str) -> str:
    """What is wrong with a token, never the token itself; empty: nothing."""
    if not SHORTEST <= len(token) <= LONGEST:
        return f"has {len(token)} characters, not {SHORTEST} to {LONGEST}"
    if not all("!" <= character <= "~" for character in token):
        return "holds other characters than letters, digits and signs of ASCII"
    return ""
