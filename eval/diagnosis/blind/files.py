"""The files of a blind test: the list of its cases, their logs, and the key, sealed.

Nobody reads the key without the secret, and nobody changes it unnoticed. The standard library has
no cipher; a stream cipher is put together from what it has. The secret becomes two keys by
PBKDF2-HMAC-SHA-256 (RFC 8018), the text is XORed with SHAKE-256 of one of them (an
extendable-output function, FIPS 202) and an HMAC-SHA-256 of the other goes in front (encrypt, then
authenticate). It keeps an honest person from looking, and shows that nobody has.
"""

from __future__ import annotations

import gzip
import hashlib
import hmac
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from eval.diagnosis.applied import read_document
from eval.diagnosis.blind.truth import Channels
from narxcal.support.csv_text import log_csv
from narxcal.support.errors import ConfigError, DataError

MARK: Final = b"narxcal.blind_key/1\n"
_ROUNDS = 200_000
_TAG = 32


def sealed(document: Mapping[str, Any], secret: str, salt: bytes) -> bytes:
    """Seal a document that JSON can hold; the same arguments give the same bytes.

    `salt` has to be another one for every document that the secret seals: the digest of what the
    document is about.
    """
    text = json.dumps(document, sort_keys=True).encode()
    cipher, signer = _keys(secret, salt)
    body = _mixed(text, cipher)
    return MARK + hmac.digest(signer, salt + body, "sha256") + body


def opened(content: bytes, secret: str, salt: bytes, file: Path | None = None) -> dict[str, Any]:
    """Open what `sealed` made.

    Raises `DataError` for what is no sealed key, and `ConfigError` for another secret or salt, or
    for content that was changed: from outside these cannot be distinguished.
    """
    if not content.startswith(MARK) or len(content) < len(MARK) + _TAG:
        raise DataError("is no sealed key", file=file, hint="`narxcal blind make` writes one")
    tag, body = content[len(MARK) : len(MARK) + _TAG], content[len(MARK) + _TAG :]
    cipher, signer = _keys(secret, salt)
    if not hmac.compare_digest(tag, hmac.digest(signer, salt + body, "sha256")):
        raise ConfigError(
            "the key does not open: the secret is another one, or the key or the list of the "
            "cases was changed since they were made",
            file=file,
            hint="Give the secret (or the seed) of `blind make` by --secret, once more for every "
            "folder that has another",
        )
    document: dict[str, Any] = json.loads(_mixed(body, cipher))
    return document


def _keys(secret: str, salt: bytes) -> tuple[bytes, bytes]:
    both = hashlib.pbkdf2_hmac("sha256", secret.encode(), salt, _ROUNDS, dklen=64)
    return both[:32], both[32:]


def _mixed(text: bytes, key: bytes) -> bytes:
    stream = hashlib.shake_256(key).digest(len(text))
    return bytes(a ^ b for a, b in zip(text, stream, strict=True))


SCHEMA: Final = "narxcal.blind/1"
KEY_SCHEMA: Final = "narxcal.blind_key/1"
CASES, KEY = "cases.json", "key.json.sealed"
ANOTHER: Final = "Is this the right folder?"
FOLDERS: Final = ("sim", "real", "sim_heldout", "real_heldout")


def write_log(file: Path, channels: Channels) -> str:
    """Write channels `(time,)` as gzipped CSV; returns the SHA-256 of the file.

    Blank where there is no reading. The zip bears no time, so that the same numbers are the same
    bytes.
    """
    content = gzip.compress(log_csv(channels, 8).encode(), 6, mtime=0)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)
    return hashlib.sha256(content).hexdigest()


def read_cases(folder: Path) -> dict[str, Any]:
    """Read the list of the cases, whose logs have to be there.

    Raises `DataError` for a folder that `blind make` did not write, and for a missing log.
    """
    document = read_document(folder / CASES, SCHEMA, DataError, ANOTHER)
    listed = document.get("logs")
    if not isinstance(listed, dict) or not all(isinstance(one, dict) for one in listed.values()):
        raise DataError("'logs' is no table of cases and their logs", file=folder / CASES)
    for case, logs in listed.items():
        for log in logs:
            if not (folder / case / log).is_file():
                raise DataError("the log is gone", file=folder / case / log)
    return document


def open_key(folder: Path, *secrets: str) -> dict[str, Any]:
    """Open the key of a blind test and check that its logs are still those that were made.

    It opens by whichever of the `secrets` fits. Raises `DataError` for a missing key and changed
    logs, `ConfigError` where no secret opens it.
    """
    cases, file = read_cases(folder), folder / KEY
    if not file.is_file():
        raise DataError("there is no key", file=file, hint="Put it back where `blind make` put it")
    key = _first_that_opens(file, secrets, salt_of(cases))
    for case, logs in cases["logs"].items():
        for log, digest in logs.items():
            path = folder / case / log
            if hashlib.sha256(path.read_bytes()).hexdigest() != digest:
                raise DataError("the log was changed since it was made", file=path)
    return key


def _first_that_opens(file: Path, secrets: Sequence[str], salt: bytes) -> dict[str, Any]:
    content = file.read_bytes()
    for secret in secrets[:-1]:
        with suppress(ConfigError):
            return opened(content, secret, salt, file)
    return opened(content, secrets[-1], salt, file)


def salt_of(cases: Mapping[str, Any]) -> bytes:
    """What binds the key to these very logs: the digest of all their digests."""
    return hashlib.sha256(json.dumps(cases["logs"], sort_keys=True).encode()).digest()
