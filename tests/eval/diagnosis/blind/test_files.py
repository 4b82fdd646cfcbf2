"""A seal keeps the key from being read or changed, and opens for who may."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.diagnosis.blind.files import MARK, opened, sealed
from narxcal.support.errors import ConfigError, DataError

KEY = {"cases": {"case_001": {"kind": "null"}}, "numbers": [1, 2.5, None]}
SALT = b"salt of these cases"


def test_what_is_sealed_opens():
    content = sealed(KEY, "secret", SALT)
    assert opened(content, ["secret"], SALT) == KEY
    assert content == sealed(KEY, "secret", SALT)


def test_nothing_of_it_is_to_be_read():
    content = sealed(KEY, "secret", SALT)
    assert content.startswith(MARK)
    for word in (b"case_001", b"null", b"secret", b"cases"):
        assert word not in content[len(MARK) :]


@pytest.mark.parametrize(("secret", "salt"), [("Secret", SALT), ("", SALT), ("secret", b"other")])
def test_another_secret_or_salt_does_not_open_it(secret, salt):
    with pytest.raises(ConfigError, match=r"key.sealed: the key does not open: the secret is"):
        opened(sealed(KEY, "secret", SALT), [secret], salt, "key.sealed")


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(1, 255))
def test_any_changed_byte_is_noticed(place, flip):
    content = bytearray(sealed(KEY, "secret", SALT))
    content[len(MARK) + place % (len(content) - len(MARK))] ^= flip
    with pytest.raises(ConfigError, match="does not open"):
        opened(bytes(content), ["secret"], SALT)


@pytest.mark.parametrize("content", [b"", b"{}", MARK, MARK + b"short"])
def test_what_is_no_key_is_said_to_be_none(content):
    with pytest.raises(DataError, match="is no sealed key"):
        opened(content, ["secret"], SALT)


def test_salts_give_other_streams():
    one, two = sealed(KEY, "secret", b"a"), sealed(KEY, "secret", b"b")
    assert len(one) == len(two)
    assert one[len(MARK) + 32 :] != two[len(MARK) + 32 :]
