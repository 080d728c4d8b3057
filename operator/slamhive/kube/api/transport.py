# SPDX-License-Identifier: Apache-2.0
"""Calls to the Kubernetes API: plain JSON over one pool of connections.

All calls pass through ``Transport.call``: there they are counted, repeated where they failed in passing, and
broken on purpose by tests. A call whose answer was lost may have been carried out. Repeating it is safe: a
create then finds the name taken (``AlreadyExists``), a checked patch finds a newer object (``Conflict``), a
delete finds nothing.
"""

from __future__ import annotations

import asyncio
import os
import random
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import urlencode
from urllib.request import getproxies_environment

import aiohttp
from kubernetes.aio.client import ApiClient, Configuration
from kubernetes.aio.config import ConfigException, load_incluster_config, load_kube_config

from slamhive.kube.api.encoding import decode, encode
from slamhive.kube.api.errors import ApiError, ServerFault, StartError, TooManyRequests, from_answer

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping

    from slamhive.kube.api.kinds import Object


ATTEMPTS = 5
FIRST_BACKOFF_SECONDS = 0.2
LAST_BACKOFF_SECONDS = 10.0
LONGEST_WAIT_SECONDS = 30.0
TIMEOUT_SECONDS = 30.0
CONNECT_SECONDS = 10.0
CONNECTIONS = 32
_LONGEST_LINE = 2**21

JSON = "application/json"
NAMESPACE_OF_POD = Path("/var/run/secrets/kubernetes.io/serviceaccount/namespace")
"""File in each pod with an account that says in which namespace it is."""


@dataclass(frozen=True)
class Request:
    """One call: how roles name it, and how HTTP does."""

    verb: str
    resource: str
    target: str
    method: str
    path: str
    query: Mapping[str, Any] | None = None
    body: Object | None = None
    content_type: str = JSON

    def __str__(self) -> str:
        return f"{self.verb} {self.resource} {self.target}"


@dataclass(frozen=True)
class Access:
    """Address and credentials of the API server, as watches need them."""

    server: str
    ca_path: str | None
    insecure: bool
    token: str | None = field(repr=False)
    certificate_path: str | None
    private_key_path: str | None
    proxy_url: str | None


class Transport:
    """Carries calls to the API server and answers back.

    Args:
        client: the official client, which knows address, certificates and tokens.
        fault: called with ("before" | "after", verb, resource) around each attempt of each call; what it
            raises is treated like a fault of the connection if it is one (OSError), and passes otherwise.
        count: called with (verb, resource, status or reason) after each attempt.
        sleep: waits some seconds.
        jitter: returns a number in [0, 1).
        attempts: times that a call is tried.
    """

    def __init__(
        self,
        client: ApiClient,
        *,
        fault: Callable[[str, str, str], None] | None = None,
        count: Callable[[str, str, str], None] | None = None,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
        jitter: Callable[[], float] = random.random,
        attempts: int = ATTEMPTS,
    ) -> None:
        self._client = client
        self.fault = fault
        self.count = count
        self._sleep = sleep
        self._jitter = jitter
        self._attempts = attempts
        self._session: aiohttp.ClientSession | None = None

    @classmethod
    async def connect(
        cls, kubeconfig: Path | None = None, context: str | None = None, **options: Any
    ) -> Self:
        """Return the API of the cluster this program runs in or, else, of a kubeconfig.

        Args:
            kubeconfig: file to use even inside a cluster; default: the KUBECONFIG variable or ~/.kube/config.
            context: context of the kubeconfig; default: its current one.
            options: as for the class.

        Raises:
            StartError: neither is there.
        """
        configuration = Configuration()
        configuration.connection_pool_maxsize = CONNECTIONS
        # Otherwise each call looks for a netrc file, in a thread; nothing in one is for this server.
        configuration.client_session_kwargs = {"trust_env": _has_proxies()}
        try:
            if kubeconfig is None and context is None:
                try:
                    load_incluster_config(client_configuration=configuration)  # type: ignore[no-untyped-call]
                    return cls(ApiClient(configuration), **options)
                except ConfigException:
                    pass
            file = _kubeconfig(kubeconfig)
            await load_kube_config(  # type: ignore[no-untyped-call]
                config_file=file, context=context, client_configuration=configuration
            )
        except (ConfigException, OSError) as error:
            raise StartError(
                f"no cluster is known: this is no pod of one, and no kubeconfig can be used ({error}); "
                "set KUBECONFIG or write ~/.kube/config"
            ) from None
        return cls(ApiClient(configuration), **options)

    async def access(self) -> Access:
        """Return the access to the server, with a fresh token, for kopf's watches."""
        configuration = self._client.configuration
        authorization = await configuration.get_api_key_with_prefix("BearerToken") or ""
        return Access(
            server=configuration.host,
            ca_path=configuration.ssl_ca_cert,
            insecure=not configuration.verify_ssl,
            token=authorization.split()[-1] if authorization else None,
            certificate_path=configuration.cert_file,
            private_key_path=configuration.key_file,
            proxy_url=configuration.proxy,
        )

    @property
    def session(self) -> aiohttp.ClientSession:
        """Return the pool of connections of all calls.

        The official client has one too, but writes each body by the slow encoder of Python's own.
        """
        if self._session is None:
            rest = self._client.rest_client
            connector = aiohttp.TCPConnector(limit=CONNECTIONS, ssl=rest.ssl_context)
            self._session = aiohttp.ClientSession(
                connector=connector, trust_env=_has_proxies(), read_bufsize=_LONGEST_LINE
            )
        return self._session

    async def close(self) -> None:
        """Close all connections."""
        if self._session is not None:
            await self._session.close()
        await self._client.close()  # type: ignore[no-untyped-call]

    async def json(
        self, request: Request, *, attempts: int | None = None, again_on: tuple[type[ApiError], ...] = ()
    ) -> Object:
        """Carry out a call whose answer is a JSON object; arguments and errors as ``call``."""
        content = await self.call(request, attempts=attempts, again_on=again_on)
        try:
            answer = decode(content)
        except ValueError:
            answer = None
        if not isinstance(answer, dict):
            raise ServerFault(
                f"cannot {request}: the answer is not a JSON object",
                verb=request.verb,
                resource=request.resource,
            )
        return answer

    async def call(
        self, request: Request, *, attempts: int | None = None, again_on: tuple[type[ApiError], ...] = ()
    ) -> bytes:
        """Carry out a call, again where it failed in passing, and return the answer's content.

        Args:
            request: the call.
            attempts: times to try; default: those of the whole transport.
            again_on: errors that pass, beside those that always do (429, 5xx, broken connections).

        Raises:
            ApiError: see ``slamhive.kube.api.errors``.
        """
        left = self._attempts if attempts is None else attempts
        wait = FIRST_BACKOFF_SECONDS
        while True:
            left -= 1
            try:
                return await self._attempt(request)
            except ApiError as error:
                if not isinstance(error, (TooManyRequests, ServerFault, *again_on)):
                    raise
                asked = getattr(error, "retry_after", None)
                # A longer wait is left to the queue: here it would keep a worker from all other objects.
                if left <= 0 or (asked or 0.0) > LONGEST_WAIT_SECONDS:
                    raise
                # By chance a little longer or shorter, so that what failed together does not come back
                # together.
                await self._sleep(max(asked or 0.0, wait * (0.5 + 0.5 * self._jitter())))
                wait = min(2 * wait, LAST_BACKOFF_SECONDS)

    async def _attempt(self, request: Request) -> bytes:
        code = "failed"
        try:
            self._break("before", request)
            status, content, headers = await self._send(request)
            code = str(status)
            self._break("after", request)
        # Whether the server has done it is not known: see the module's docstring for why that is safe.
        except (aiohttp.ClientError, TimeoutError, OSError) as error:
            said = str(error) or type(error).__name__
            raise ServerFault(
                f"cannot {request}: no answer: {said}", verb=request.verb, resource=request.resource
            ) from error
        finally:
            if self.count is not None:
                self.count(request.verb, request.resource, code)
        if status >= 400:
            raise from_answer(status, content, headers, request.verb, request.resource, request.target)
        return content

    def _break(self, moment: str, request: Request) -> None:
        if self.fault is not None:
            self.fault(moment, request.verb, request.resource)

    async def _send(self, request: Request) -> tuple[int, bytes, Mapping[str, str]]:
        configuration = self._client.configuration
        headers = {"Accept": JSON, "User-Agent": "slamhive", "Content-Type": request.content_type}
        await self._client.update_params_for_auth(
            headers, [], ["BearerToken"], request.path, request.method, request.body
        )
        query = {name: value for name, value in (request.query or {}).items() if value is not None}
        address = configuration.host + request.path + (f"?{urlencode(query)}" if query else "")
        timeout = aiohttp.ClientTimeout(total=TIMEOUT_SECONDS, connect=CONNECT_SECONDS)
        rest = self._client.rest_client
        answer = await self.session.request(
            request.method,
            address,
            headers=headers,
            data=None if request.body is None else encode(request.body),
            timeout=timeout,
            server_hostname=configuration.tls_server_name,
            proxy=rest.proxy,
            proxy_headers=rest.proxy_headers,
        )
        content: bytes = await answer.read()
        return answer.status, content, answer.headers


def _has_proxies() -> bool:
    """Tell whether the environment names a proxy."""
    return any(name != "no" for name in getproxies_environment())


def _kubeconfig(given: Path | None) -> str:
    files = str(given or os.environ.get("KUBECONFIG") or Path("~/.kube/config").expanduser())
    if not any(Path(file).is_file() for file in files.split(os.pathsep)):
        raise FileNotFoundError(f"there is no file {files}")
    return files
