"""A simulation watched while it runs."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, positive
from ffsms_pin.errors import FfsmsWarning
from ffsms_pin.opt.goals.goal import REACH
from ffsms_pin.simulation.events import Event
from ffsms_pin.simulation.interfaces import Instant, Reference, Supervisor, target_function
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.viewer.around import Body
from ffsms_pin.viewer.frames import FREE, Frames, Target
from ffsms_pin.viewer.page import chosen_layers, facts, live_page, readings, staged
from ffsms_pin.viewer.robot import moving_layers
from ffsms_pin.viewer.server import Server, open_browser


class LiveView:
    """A live page that shows one state after another.

    >>> with LiveView(sms, q0, target) as live:                               # doctest: +SKIP
    ...     tracking = simulate(sms, live.watch(plan), controller)

    Parameters
    ----------
    sms : SpaceManipulator
        What is shown: the plant, where that is not the model.
    q : array_like, shape (nq,)
        Configuration that is shown first.
    target : array_like, shape (3,), or callable, optional
        As in `view`.
    client : Client or ClientMotion, optional
        A body that is drawn, as `view` has it; where a supervised run moves it (`supervise`), there.
    speed : float, optional
        How fast a watched simulation runs at most, 1 being true time; None does not hold it up.
    kappa : float
        Of the cone.
    fps : float
        Updates of the page for each second of this machine's time, at most.
    browser : bool
        Whether to open a window of the default browser.
    host : str, optional
        Name or address of an interface on which other machines may open the page ("0.0.0.0" for all), with
        the address `url`, which holds a secret. Default: this machine only.

    Raises
    ------
    InvalidValue
        A value out of range.
    ViewerError
        The page cannot be served. Once it is served, what goes wrong with it is one warning
        (`FfsmsWarning`), and the simulation goes on without it.

    Attributes
    ----------
    url : str
        Of the page.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        q: ArrayLike,
        target: Target | None = None,
        *,
        client: Body | None = None,
        speed: float | None = 1.0,
        kappa: float = 10.0,
        fps: float = 30.0,
        browser: bool = True,
        host: str | None = None,
    ) -> None:
        self._sms, self._kappa = sms, kappa
        self._pace = 0.0 if speed is None else 1.0 / positive("speed", speed)
        self._pause = 1.0 / positive("fps", fps, "1/s")
        self._goal = None if target is None else target_function(target)
        self._started = self._shown = -np.inf
        self._ended, self._end = False, 0.0
        self._client: Any = None
        if client is not None:
            self._client = SimpleNamespace(shapes=client.shapes, poses=client.poses)
        self._force = np.zeros(3)
        first = self._frame(0.0, sms.checked_configuration("q", q), np.zeros(sms.nv))
        stage, seen = staged(first, FREE, client)
        self._stage = stage
        self._shows = moving_layers(stage, first, REACH, self._client)
        self._draw(first)
        said = facts(stage, first, chosen_layers(None), speed, True, seen)
        self._server = Server(host, stage.scene, live_page(sms.model.name, said | {"running": True}))
        self.url = self._server.url
        if browser:
            open_browser(self.url)

    def show(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Show the state (q, v) at time t [s]; a page that fails is told in one warning, then left alone."""
        if self._ended:
            return
        try:
            self._server.check()
            self._draw(self._frame(t, q, v))
        except Exception as error:  # whatever it is, the run that is watched matters more
            self._ended = True
            warnings.warn(
                f"the live page shows nothing from t = {t:g} s on ({error}); the run goes on without it",
                FfsmsWarning,
                stacklevel=2,
            )

    def watch(self, reference: Reference) -> Reference:
        """The same reference, which shows the plant's state whenever the simulation asks it."""
        self._end = float(reference.duration)
        return cast(Reference, _Watched(reference, self))

    def supervise(self, supervisor: Supervisor | None = None) -> Supervisor:
        """The same supervisor, or one that decides nothing; what it sees of client and contact is shown."""
        return _Supervised(supervisor, self)

    def touch(self, now: Instant) -> None:
        """Keep where the client is, and the largest force on the end effector since the last picture."""
        if self._client is not None:
            pose = now.client_pose
            self._client.poses = lambda times: (pose.translation[None], pose.rotation[None])
        self._force = max(self._force, np.array(now.wrench[:3]), key=lambda one: float(np.linalg.norm(one)))

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """`show`, but not more often than the page needs, and not sooner than `speed` allows."""
        if self._ended:  # nobody watches any more: no reason to hold up the run
            return
        now = time.monotonic()
        due = t * self._pace
        if t <= 0.0 or not np.isfinite(self._started):
            self._started = now - due
        if (ahead := self._started + due - now) > 0.0:
            time.sleep(ahead)
            now += ahead
        if now - self._shown >= self._pause:
            self._shown = now
            self.show(t, q, v)

    def close(self) -> None:
        """Stop the page."""
        self._ended = True
        self._server.close()

    def __enter__(self) -> LiveView:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _frame(self, t: float, q: FloatArray, v: FloatArray) -> Frames:
        goal = None if self._goal is None else self._goal(t)[None]
        force = None if self._client is None else self._force[None]
        self._force = np.zeros(3)
        return Frames(self._sms, np.array([t]), q[None], v[None], goal, self._kappa, force)

    def _draw(self, frame: Frames) -> None:
        t = float(frame.t[0])
        now = {"t": t, "end": max(self._end, t), "values": [one["values"][0] for one in readings(frame)]}
        self._stage.tell("clock", "userData", now)
        for show in self._shows:
            show(frame, 0)


class _Watched:
    """A reference that passes on what it is asked, and what it observes to a page too."""

    def __init__(self, reference: Reference, live: LiveView) -> None:
        self._reference, self._live = reference, live

    def __getattr__(self, name: str) -> Any:
        return getattr(self._reference, name)

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        inner = getattr(self._reference, "observe", None)
        if inner is not None:
            inner(t, q, v)
        self._live.observe(t, q, v)


class _Supervised:
    """A supervisor that passes on what it decides, and what it sees to a page too."""

    def __init__(self, supervisor: Supervisor | None, live: LiveView) -> None:
        self._supervisor, self._live = supervisor, live

    @property
    def model(self) -> SpaceManipulator:
        return self._live._sms if self._supervisor is None else self._supervisor.model

    def decide(self, now: Instant) -> Sequence[Event]:
        self._live.touch(now)
        return () if self._supervisor is None else self._supervisor.decide(now)
