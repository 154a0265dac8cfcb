"""Show a running simulation: a supervisor draws the plant in Meshcat's own viewer.

Run: python examples/live_meshcat.py --open (pip install meshcat). Without --open, no browser is opened and
the simulation runs at full speed.
"""

import asyncio
import sys
import time
from functools import partialmethod
from queue import Queue
from threading import Thread

import meshcat
import numpy as np
from meshcat.servers.zmqserver import ZMQWebSocketBridge
from pinocchio.visualize import MeshcatVisualizer
from tornado.web import Application

import ffsms_pin as ffsms
from ffsms_pin import opt

OPEN = "--open" in sys.argv
PERIOD = 1.0 / 30.0  # [s] of simulated time between two pictures


def serve(address: Queue) -> None:
    """Run Meshcat's server on the loopback interface; without this change it listens on all interfaces."""
    asyncio.set_event_loop(asyncio.new_event_loop())
    Application.listen = partialmethod(Application.listen, address="127.0.0.1")
    bridge = ZMQWebSocketBridge()
    address.put(bridge.zmq_url)
    bridge.run()


class Live(ffsms.simulation.Supervisor):
    """A supervisor that draws the plant's state and triggers no events."""

    def __init__(self, sms: ffsms.SpaceManipulator, viewer: MeshcatVisualizer) -> None:
        self.model, self.viewer, self.started, self.drawn = sms, viewer, time.monotonic(), []

    def decide(self, now: ffsms.simulation.Instant) -> tuple[()]:
        """Draw the state `now` if a picture is due."""
        if not self.drawn or now.t >= self.drawn[-1] + PERIOD:
            time.sleep(max(0.0, self.started + now.t - time.monotonic()) if OPEN else 0.0)
            self.viewer.display(now.q)
            self.drawn.append(now.t)
        return ()


sms = ffsms.load("planar_3r")
plan = opt.plan(sms, sms.configuration(np.radians([1, 1, 1])), [0.45, 0.65, 0.0], duration=12.0)
Thread(target=serve, args=(urls := Queue(),), daemon=True).start()
viewer = MeshcatVisualizer(sms.model, visual_model=sms.geometry("visual"))
viewer.initViewer(meshcat.Visualizer(zmq_url=urls.get(timeout=30.0)), open=OPEN)
viewer.loadViewerModel()
live = Live(sms, viewer)
track = ffsms.simulate(sms, plan, ffsms.SlidingModeController(sms), supervisor=live)
assert plan.reached
assert track.position_error[-1] < 2e-3
assert live.drawn[-1] > plan.duration - 2 * PERIOD
print(f"drawn {len(live.drawn)} times, {1e3 * track.position_error[-1]:.2f} mm final position error")
