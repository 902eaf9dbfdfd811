"""Who may do what: a page of another site may nothing, a page without the token may look.

The server listens on loopback. A browser on this machine would still let any site's page open a websocket to it, so that
the page's origin is compared; and a site could point its own name at 127.0.0.1 (DNS rebinding), so that the host is too.
"""

import hmac
import ipaddress
import secrets
from dataclasses import dataclass, field
from typing import Final
from urllib.parse import urlsplit

TOKEN_BYTES: Final = 24


def is_loopback(host: str) -> bool:
    """Return whether an address is of this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True)
class Access:
    """The rules of one server.

    Args:
        host: where it listens; anything but loopback has no token: beyond this machine one may only look, for the token
            would go over the network in clear.
        look_only: no token at all.
    """

    host: str
    look_only: bool = False
    _token: str = field(default_factory=lambda: secrets.token_urlsafe(TOKEN_BYTES), repr=False)

    @property
    def token(self) -> str:
        """What a page must know to command; empty where none may."""
        return "" if self.look_only or not is_loopback(self.host) else self._token

    @property
    def hosts(self) -> list[str]:
        """Names under which the page may be asked for."""
        return ["127.0.0.1", "localhost", "[::1]"] if is_loopback(self.host) else [self.host]

    def allows(self, token: str) -> bool:
        """Return whether this token commands."""
        return bool(self.token) and hmac.compare_digest(token.encode(), self.token.encode())

    def is_own(self, origin: str | None, host: str | None) -> bool:
        """Return whether a websocket was opened by a page of this server."""
        if origin is None or host is None:
            return False
        try:
            parts = urlsplit(origin)
        except ValueError:
            return False
        return parts.scheme == "http" and parts.netloc == host and self.knows(host)

    def knows(self, host: str) -> bool:
        """Return whether a Host header names this server."""
        name = host if host.endswith("]") else host.rpartition(":")[0] or host
        return name in self.hosts
