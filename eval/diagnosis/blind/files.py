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
from pathlib import Path
from typing import Any, Final

from eval.diagnosis.applied import read_document
from narxcal.support.errors import ConfigError, DataError
from narxcal.support.files import sha256_of

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


def opened(
    content: bytes, secrets: Sequence[str], salt: bytes, file: Path | None = None
) -> dict[str, Any]:
    """Open what `sealed` made, by whichever of the secrets fits.

    Raises `DataError` for what is no sealed key, and `ConfigError` for other secrets or salts, or
    for content that was changed: from outside these cannot be distinguished.
    """
    if not content.startswith(MARK) or len(content) < len(MARK) + _TAG:
        raise DataError("is no sealed key", file=file, hint="`narxcal blind make` writes one")
    tag, body = content[len(MARK) : len(MARK) + _TAG], content[len(MARK) + _TAG :]
    for cipher, signer in (_keys(secret, salt) for secret in secrets):
        if hmac.compare_digest(tag, hmac.digest(signer, salt + body, "sha256")):
            document: dict[str, Any] = json.loads(_mixed(body, cipher))
            return document
    raise ConfigError(
        "the key does not open: the secret is another one, or the key or the list of the cases "
        "was changed since they were made",
        file=file,
        hint="Give the secret (or the seed) of `blind make` by --secret, once more for every "
        "folder that has another",
    )


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


def write_log(file: Path, text: str) -> str:
    """Write the text of a log, gzipped without a time: the same text is the same bytes.

    Returns the SHA-256 of the file.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(gzip.compress(text.encode(), 6, mtime=0))
    return sha256_of(file)


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
    key = opened(file.read_bytes(), secrets, salt_of(cases), file)
    for case, logs in cases["logs"].items():
        for log, digest in logs.items():
            path = folder / case / log
            if sha256_of(path) != digest:
                raise DataError("the log was changed since it was made", file=path)
    return key


def salt_of(cases: Mapping[str, Any]) -> bytes:
    """What binds the key to these very logs: the digest of all their digests."""
    return hashlib.sha256(json.dumps(cases["logs"], sort_keys=True).encode()).digest()
