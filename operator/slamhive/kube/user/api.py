# SPDX-License-Identifier: Apache-2.0
"""API client of users' commands: the operator's client plus dry runs, following logs, and programs in pods.

A program's streams are carried by the protocol v4.channel.k8s.io. Messages are binary, and their first byte
says what they carry: 0 standard input, 1 standard output, 2 standard error, 3 how the program ended, as a
Status object.
"""

from __future__ import annotations

import json
from contextlib import aclosing, asynccontextmanager
from typing import TYPE_CHECKING, Any, NoReturn
from urllib.parse import urlencode

import aiohttp

from slamhive.kube.api.client import Api
from slamhive.kube.api.errors import ServerFault, from_answer
from slamhive.kube.api.transport import CONNECT_SECONDS, Request

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, AsyncIterator, Sequence

    from slamhive.kube.api.kinds import Key, Kind, Object

PROTOCOL = "v4.channel.k8s.io"
_IN, _OUT, _ERROR, _STATUS = range(4)
_PIECE = 1 << 14
_PROGRAM_SILENCE_SECONDS = 120.0
_SAID_BYTES = 2000
_LONGEST_LINE = 4 << 20

_MERGE = "application/merge-patch+json"
_LOG_SILENCE_SECONDS = 900.0
_TRIAL = {"dryRun": "All"}


class PodSession:
    """A program that runs in a pod.

    Args:
        socket: the connection to it.
        target: which pod, as NAMESPACE/NAME.
        silence: how long it may say nothing while something is waited for, s.
    """

    def __init__(
        self, socket: aiohttp.ClientWebSocketResponse, target: str, silence: float = _PROGRAM_SILENCE_SECONDS
    ) -> None:
        self._socket = socket
        self._target = target
        self._silence = silence
        self._rest = bytearray()
        self._said = b""
        self._status = ""

    async def send(self, data: bytes) -> None:
        """Write to the program's standard input.

        Raises:
            ServerFault: the connection broke.
        """
        try:
            for place in range(0, len(data), _PIECE):
                await self._socket.send_bytes(bytes([_IN]) + data[place : place + _PIECE])
        except (aiohttp.ClientError, OSError) as error:
            self._break(str(error) or type(error).__name__)

    async def line(self) -> bytes:
        """Return the next line of the program's standard output.

        Raises:
            ServerFault: it ended, or the connection broke.
        """
        while (end := self._rest.find(b"\n")) < 0:
            if len(self._rest) > _LONGEST_LINE:
                self._break(f"a line is longer than {_LONGEST_LINE} bytes")
            self._rest += await self._more()
        line = bytes(self._rest[:end])
        del self._rest[: end + 1]
        return line

    async def take(self, count: int) -> AsyncGenerator[bytes, None]:
        """Yield the next bytes of the program's standard output, as they come.

        Raises:
            ServerFault: it ended, or the connection broke.
        """
        while count:
            data = bytes(self._rest[:count]) if self._rest else b""
            if data:
                del self._rest[: len(data)]
            else:
                more = await self._more()
                data = more[:count]
                self._rest += more[count:]
            count -= len(data)
            yield data

    async def _more(self) -> bytes:
        while True:
            try:
                message = await self._socket.receive(self._silence)
            except TimeoutError:
                self._break(f"silent for {self._silence:.0f} s")
            except (aiohttp.ClientError, OSError) as error:
                self._break(str(error) or type(error).__name__)
            if message.type is not aiohttp.WSMsgType.BINARY or not message.data:
                if message.type in {aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY}:
                    continue
                self._break(self._end())
            channel, data = message.data[0], message.data[1:]
            if channel == _OUT and data:
                return bytes(data)
            if channel == _ERROR:
                self._said = (self._said + data)[-_SAID_BYTES:]
            elif channel == _STATUS:
                self._status = data.decode(errors="replace")

    def _end(self) -> str:
        """Return the end of the program in words, as far as it is known."""
        said = self._said.decode(errors="replace").strip()
        try:
            status = json.loads(self._status)
            ended = "it ended" if status.get("status") == "Success" else str(status.get("message"))
        except (ValueError, AttributeError):
            ended = "the connection was closed"
        return f"{ended}: {said.splitlines()[-1]}" if said else ended

    def _break(self, why: str) -> NoReturn:
        raise ServerFault(f"pod {self._target}: {why}", verb="get", resource="pods/exec") from None


class UserApi(Api):
    """The API as a user's command has it."""

    async def try_create(self, kind: Kind, namespace: str, body: Object) -> None:
        """Let the server check an object without making it; errors as of ``create``."""
        target, path = f"{namespace}/{body['metadata']['name']}", kind.path(namespace)
        body = {"apiVersion": kind.api_version, "kind": str(kind)} | body
        await self.json(Request("create", kind.resource, target, "POST", path, query=_TRIAL, body=body))

    async def try_patch(self, key: Key, body: Object) -> None:
        """Let the server check a change without making it; errors as of ``patch``."""
        path = key.kind.path(key.namespace, key.name)
        request = Request(
            *("patch", key.kind.resource, f"{key.namespace}/{key.name}", "PATCH", path),
            query=_TRIAL,
            body=body,
            content_type=_MERGE,
        )
        await self.json(request)

    async def log_lines(
        self,
        namespace: str,
        pod: str,
        container: str,
        *,
        follow: bool = False,
        since: str | None = None,
        tail_lines: int | None = None,
    ) -> AsyncGenerator[tuple[str, str], None]:
        """Yield each line that a container wrote, with its time stamp (RFC 3339).

        Args:
            namespace: where the pod is.
            pod: its name.
            container: whose lines.
            follow: whether to wait for further lines until the container ends.
            since: only lines later than this time stamp.
            tail_lines: only so many of the last lines.

        Raises:
            ServerFault: the connection broke; what came so far was yielded.
            ApiError: see ``slamhive.kube.api.errors``.
        """
        query: dict[str, Any] = {"container": container, "timestamps": "true"}
        query |= {"follow": "true"} if follow else {}
        query |= {"sinceTime": since} if since else {}
        query |= {"tailLines": tail_lines} if tail_lines is not None else {}
        async with aclosing(self._lines(namespace, pod, query)) as lines:
            async for line in lines:
                stamp, _, text = line.decode(errors="replace").partition(" ")
                # sinceTime counts in whole seconds.
                if since is None or _order(stamp) > _order(since):
                    yield stamp, text

    @asynccontextmanager
    async def executing(
        self, namespace: str, pod: str, container: str, command: Sequence[str]
    ) -> AsyncIterator[PodSession]:
        """Run a program in a container of a pod, for as long as the context lasts.

        Raises:
            Forbidden: the user may not.
            ServerFault: the pod or its node does not answer.
            ApiError: see ``slamhive.kube.api.errors``.
        """
        path = f"/api/v1/namespaces/{namespace}/pods/{pod}/exec"
        wanted = [("container", container), ("stdin", "true"), ("stdout", "true"), ("stderr", "true")]
        query = urlencode([*wanted, *(("command", word) for word in command)])
        headers = {"User-Agent": "slamhive"}
        await self._client.update_params_for_auth(headers, [], ["BearerToken"], path, "GET", None)
        target = f"{namespace}/{pod}"
        try:
            socket = await self.session.ws_connect(
                f"{self._client.configuration.host}{path}?{query}",
                headers=headers,
                protocols=(PROTOCOL,),
                proxy=self._client.rest_client.proxy,
            )
        except aiohttp.WSServerHandshakeError as error:
            content = error.message.encode()
            raise from_answer(
                error.status, content, error.headers or {}, "get", "pods/exec", target
            ) from None
        except (aiohttp.ClientError, TimeoutError, OSError) as error:
            raise ServerFault(
                f"cannot get pods/exec {target}: {error or type(error).__name__}",
                verb="get",
                resource="pods/exec",
            ) from error
        async with socket:
            yield PodSession(socket, target)

    async def _lines(self, namespace: str, pod: str, query: dict[str, Any]) -> AsyncGenerator[bytes, None]:
        target = f"{namespace}/{pod}"
        path = f"/api/v1/namespaces/{namespace}/pods/{pod}/log"
        headers = {"Accept": "*/*", "User-Agent": "slamhive"}
        await self._client.update_params_for_auth(headers, [], ["BearerToken"], path, "GET", None)
        address = f"{self._client.configuration.host}{path}?{urlencode(query)}"
        # A log that is followed has no end to wait for; a quarter of an hour of silence ends the connection,
        # and the reader takes it up again.
        timeout = aiohttp.ClientTimeout(total=None, connect=CONNECT_SECONDS, sock_read=_LOG_SILENCE_SECONDS)
        try:
            answer = await self._client.rest_client.request(  # type: ignore[no-untyped-call]
                "GET", address, headers=headers, _request_timeout=timeout
            )
            if answer.status >= 400:
                content = await answer.read()
                raise from_answer(answer.status, content, answer.headers, "get", "pods/log", target)
            stream: aiohttp.ClientResponse = answer.response
            async with stream:
                rest = b""
                async for chunk in stream.content.iter_any():
                    *whole, rest = (rest + chunk).split(b"\n")
                    for line in whole:
                        yield line
                if rest:
                    yield rest
        except (aiohttp.ClientError, TimeoutError, OSError) as error:
            raise ServerFault(
                f"cannot get pods/log {target}: the connection broke: {error or type(error).__name__}",
                verb="get",
                resource="pods/log",
            ) from error


def _order(stamp: str) -> tuple[str, str]:
    """Return a key to order RFC 3339 time stamps in UTC by: their fractions drop trailing zeros."""
    whole, _, fraction = stamp.rstrip("Z").partition(".")
    return whole, fraction.ljust(9, "0")
