"""Signed models and units: whose it is, and which revision, proved by Ed25519; the self-hash in the file only tells damage.

A signature stands beside the file it is about (``M.model.json.sig``, ``F.fmu.sig``) and covers its bytes, name of the robot and revision.
Who relies on a model says which public keys it accepts and the least revision, so that an old model, however well signed, does not come
back. A unit (FMU) says in `ORIGIN` which model it was exported from.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stopset.artifact.model import Model
from stopset.artifact.store import model_of, read_model_text
from stopset.errors import ModelFileError, OutputError, StopsetError
from stopset.files import write_private, write_text
from stopset.unpacked import check_zip

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

FORMAT = "stopset signature"
SCHEMA = 1
CONTEXT = {  # no signature of anything else is one of a model, or of a unit
    "model": b"stopset model signature, schema 1\n",
    "unit": b"stopset unit signature, schema 1\n",
}
UNIT = ".fmu"  # how the name of a unit ends
ORIGIN = "documentation/model.json"  # in a unit: which model it was exported from
SUFFIX = ".sig"
LARGEST = 1 << 16  # [byte] of a key or signature file


class SigningKeyError(StopsetError):
    """A key file cannot be used: make one with ``stopset sign --new-key``."""


class NotTrusted(ModelFileError):
    """A model is not signed by an accepted key, was changed after signing, or is older than allowed."""


@dataclass(frozen=True, slots=True)
class Statement:
    """What is signed: SHA-256 of the file's bytes, and what a person should see of it."""

    file_sha256: str
    model_sha256: str
    robot: str
    revision: int

    @classmethod
    def of(cls, data: bytes, model: Model) -> Statement:
        return cls(hashlib.sha256(data).hexdigest(), model.sha256, model.robot.name, revision_of(model))

    @classmethod
    def of_unit(cls, data: bytes, path: str | Path) -> Statement:
        """Of a unit's bytes. Raises `ModelFileError` where they are none of `stopset export-fmu`."""
        try:
            check_zip(io.BytesIO(data))
            with zipfile.ZipFile(io.BytesIO(data)) as z:
                said = json.loads(z.read(ORIGIN))
            return cls(hashlib.sha256(data).hexdigest(), str(said["model_sha256"]), str(said["robot"]), int(said["revision"]))
        except (zipfile.BadZipFile, zlib.error, KeyError, ValueError, TypeError, NotImplementedError, RuntimeError) as e:
            raise ModelFileError(
                f"{path} is no unit that says which model it is of ({type(e).__name__}); expected one of `stopset export-fmu`: export it "
                "again"
            ) from e

    def bytes(self, kind: str = "model") -> bytes:
        """What the signature of a file of this ``kind`` is over: the same for the same statement."""
        return CONTEXT[kind] + json.dumps(asdict(self), sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()


@dataclass(frozen=True, slots=True)
class Accepted:
    """Whose models are taken: public keys by their id, and the least revision; without keys, unsigned ones too."""

    keys: dict[str, Any]
    least_revision: int = 0

    @classmethod
    def of(cls, paths: Sequence[str | Path], least_revision: int = 0) -> Accepted:
        """The public keys in these files. Raises `SigningKeyError`."""
        keys = [public_key(p) for p in paths]
        return cls({key_id(k): k for k in keys}, least_revision)


def revision_of(model: Model) -> int:
    """Number of a model's last revision."""
    return max((r.number for r in model.revisions), default=0)


def signature_path(model: str | Path) -> Path:
    """Where the signature of a model file stands."""
    return Path(f"{model}{SUFFIX}")


def key_id(key: Ed25519PublicKey) -> str:
    """16 letters that name a public key."""
    return hashlib.sha256(key.public_bytes_raw()).hexdigest()[:16]


def new_key(path: str | Path, passphrase: str = "") -> str:
    """Make a key pair: the secret half in ``path`` (readable by its owner alone), the public one in ``path``.pub; its id.

    With a ``passphrase`` the file alone signs nothing.
    """
    from cryptography.hazmat.primitives import serialization as s
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    public = Path(f"{path}.pub")
    for p in (Path(path), public):
        if p.exists():
            raise OutputError(f"{p} exists already; expected a new name: a key that signed something must not be lost")
    secret = Ed25519PrivateKey.generate()
    encryption = s.BestAvailableEncryption(passphrase.encode()) if passphrase else s.NoEncryption()
    write_private(path, secret.private_bytes(s.Encoding.PEM, s.PrivateFormat.PKCS8, encryption))
    text = secret.public_key().public_bytes(s.Encoding.PEM, s.PublicFormat.SubjectPublicKeyInfo).decode()
    write_text(public, text)
    return key_id(secret.public_key())


def kind_of(path: str | Path) -> str:
    """Whether a file is a model or a unit, by its name."""
    return "unit" if Path(path).suffix == UNIT else "model"


def _stated(data: bytes, path: str | Path) -> Statement:
    return Statement.of_unit(data, path) if kind_of(path) == "unit" else Statement.of(data, model_of(data, path))


def sign(path: str | Path, key: str | Path, passphrase: str = "") -> tuple[Statement, str]:
    """Write the signature of a model file or unit beside it; what was signed, and the key's id. Raises `ModelFileError`,
    `SigningKeyError`."""
    statement = _stated(read_model_text(path), path)
    secret = secret_key(key, passphrase)
    public = secret.public_key()
    body = {
        "format": FORMAT, "schema": SCHEMA, **asdict(statement), "key": key_id(public),
        "signature": base64.b64encode(secret.sign(statement.bytes(kind_of(path)))).decode(),
    }  # fmt: skip
    write_text(signature_path(path), json.dumps(body, indent=1) + "\n")
    return statement, key_id(public)


def load_trusted(path: str | Path, accepted: Accepted) -> Model:
    """Read a model file as `load_model` does, and refuse one that is not trusted: the very bytes that were checked are used.

    Raises `NotTrusted` with one sentence, and what `load_model` raises.
    """
    data = read_model_text(path)
    if accepted.keys:
        _check(data, path, accepted)
    model = model_of(data, path)
    _new_enough(revision_of(model), path, accepted)
    return model


def verified(path: str | Path, accepted: Accepted) -> Statement:
    """What is vouched for in a model file or unit that is trusted. Raises as `load_trusted` does."""
    data = read_model_text(path)
    if accepted.keys:
        _check(data, path, accepted)
    statement = _stated(data, path)
    _new_enough(statement.revision, path, accepted)
    return statement


def signer(path: str | Path) -> str | None:
    """Id of the key that a file's signature names, None where it has none; proves nothing, see `verified`. Raises `NotTrusted`."""
    return _signature(path)[1] if signature_path(path).exists() else None


def _new_enough(revision: int, path: str | Path, accepted: Accepted) -> None:
    if revision < accepted.least_revision:
        raise NotTrusted(
            f"{path} is revision {revision}; expected at least {accepted.least_revision}: an older {kind_of(path)} is not taken back, "
            "roll out a newer one"
        )


def _check(data: bytes, path: str | Path, accepted: Accepted) -> None:
    """Refuse bytes that no accepted key has signed."""
    from cryptography.exceptions import InvalidSignature

    statement, key, signature = _signature(path)
    if key not in accepted.keys:
        raise NotTrusted(
            f"{path} is signed by the key {key}; expected {' or '.join(sorted(accepted.keys))}: have it signed by an accepted key, or "
            "accept this one"
        )
    try:
        accepted.keys[key].verify(signature, statement.bytes(kind_of(path)))
    except InvalidSignature as e:
        raise NotTrusted(
            f"{signature_path(path)} does not hold what the key {key} signed; expected its signature unchanged: sign the {kind_of(path)} again"
        ) from e
    if statement.file_sha256 != hashlib.sha256(data).hexdigest():
        raise NotTrusted(
            f"{path} is not the file that was signed (its SHA-256 is {hashlib.sha256(data).hexdigest()[:16]}..., signed was "
            f"{statement.file_sha256[:16]}...): restore it, or look at what was changed and sign it again"
        )


def _signature(model: str | Path) -> tuple[Statement, str, bytes]:
    p = signature_path(model)
    try:
        text = _small(p).decode("utf-8")
    except FileNotFoundError as e:
        raise NotTrusted(f"{model} is not signed: there is no {p.name} beside it; expected one: `stopset sign` makes it") from e
    except (OSError, ValueError) as e:
        raise NotTrusted(
            f"{p} cannot be read as a signature ({type(e).__name__}); expected one of `stopset sign`: sign again"
        ) from e
    try:
        body = json.loads(text)
        if body.pop("format") != FORMAT or body.pop("schema") != SCHEMA:
            raise ValueError("of another format")
        signature, key = base64.b64decode(body.pop("signature"), validate=True), str(body.pop("key"))
        return Statement(**body), key, signature
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, binascii.Error) as e:
        raise NotTrusted(
            f"{p} is no signature of a model ({type(e).__name__}); expected one of `stopset sign`: sign again"
        ) from e


def public_key(path: str | Path) -> Ed25519PublicKey:
    """The public key in a PEM file. Raises `SigningKeyError`."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    key = _pem(path, load_pem_public_key, "public")
    if not isinstance(key, Ed25519PublicKey):
        raise SigningKeyError(
            f"{path} holds a {type(key).__name__}; expected an Ed25519 public key: make one with `stopset sign --new-key`"
        )
    return key


def locked(path: str | Path) -> bool:
    """Whether a secret key asks for a passphrase. Raises `SigningKeyError` where there is no key."""
    return b"ENCRYPTED" in _pem(path, lambda data: data, "secret")


def secret_key(path: str | Path, passphrase: str = "") -> Ed25519PrivateKey:
    """The secret key in a PEM file of its owner alone. Raises `SigningKeyError`."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    if locked(path) != bool(passphrase):
        said = "no passphrase" if not passphrase else "one"
        raise SigningKeyError(
            f"{path} {'asks for a' if not passphrase else 'has no'} passphrase, and {said} was given; expected the one it was made with: "
            f"{'add' if not passphrase else 'leave out'} --passphrase"
        )
    key = _pem(path, lambda data: load_pem_private_key(data, passphrase.encode() or None), "secret")
    if not isinstance(key, Ed25519PrivateKey):
        raise SigningKeyError(
            f"{path} holds a {type(key).__name__}; expected an Ed25519 secret key: make one with `stopset sign --new-key`"
        )
    mode = Path(path).stat().st_mode & 0o077
    if mode:
        raise SigningKeyError(
            f"{path} may be used by others (mode {mode:03o}); expected a secret key of its owner alone: chmod 600 {path}"
        )
    return key


def _pem(path: str | Path, read: Any, what: str) -> Any:
    from cryptography.exceptions import UnsupportedAlgorithm

    try:
        return read(_small(Path(path)))
    except FileNotFoundError as e:
        raise SigningKeyError(
            f"{path}: no such file; expected a {what} key in PEM: make one with `stopset sign --new-key`"
        ) from e
    except (OSError, ValueError, TypeError, UnsupportedAlgorithm) as e:
        if isinstance(e, ValueError) and b"ENCRYPTED" in _small(
            Path(path)
        ):  # what a wrong passphrase makes of a key is told in several ways
            raise SigningKeyError(
                f"{path}: that is not its passphrase, or the file is damaged; expected the passphrase it was made with: try again"
            ) from e
        raise SigningKeyError(
            f"{path} is no {what} key ({type(e).__name__}); expected PEM from `stopset sign --new-key`: give that"
        ) from e


def _small(path: Path) -> bytes:
    with path.open("rb") as f:
        data = f.read(LARGEST + 1)
    if len(data) > LARGEST:
        raise ValueError("too long")
    return data
