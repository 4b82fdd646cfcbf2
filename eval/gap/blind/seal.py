"""Seals a key: nobody reads it without the secret, and nobody changes it unnoticed.

The standard library has no cipher; a stream cipher is put together from what it has. The secret
becomes two keys by PBKDF2-HMAC-SHA-256 (RFC 8018), the text is XORed with SHAKE-256 of one of them
(an extendable-output function, FIPS 202) and an HMAC-SHA-256 of the other goes in front
(encrypt, then authenticate). It keeps an honest person from looking, and shows that nobody has.
"""

from __future__ import annotations

import hashlib
import hmac
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

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
    for content that was changed: from outside these cannot be told apart.
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
