"""Make an environment for reinforcement learning. Needs Gymnasium: pip install gymnasium.

The arm has to reach a random position while the base reacts. An action has the desired rate of each joint as
a share of its limit. The reference rates approach this rate within the limits of acceleration and position,
and a control law tracks them in the forward dynamics of the floating robot. A policy with the generalised
Jacobian J* solves the task.
"""

import gymnasium as gym
import numpy as np
from gymnasium.utils.env_checker import check_env

import ffsms_pin as ffsms
from ffsms_pin.control import ComputedTorque
from ffsms_pin.simulation.integrators import rk4_step


class ReachEnv(gym.Env):
    """An environment whose episodes end within 2 cm of the target, or after 20 s."""

    def __init__(self, sms, dt=0.05, substeps=10):
        self.sms, self.dt, self.substeps = sms, dt, substeps
        self.controller, self.data = ComputedTorque(sms), sms.model.createData()
        self.action_space = gym.spaces.Box(-1.0, 1.0, (sms.n,), np.float32)
        # Sines and cosines of the joints, rates over limits, displacement to the target, base twist.
        high = np.repeat([1.0, 2.0, 5.0, 2.0], [2 * sms.n, sms.n, 3, 6]).astype(np.float32)
        self.observation_space = gym.spaces.Box(-high, high)

    def observe(self):
        """Return the observation and the distance to the target [m]."""
        state, joints = self.sms.at(self.q, self.v), self.sms.joint_positions(self.q)
        displacement = state.base_pose.rotation.T @ (self.target - state.end_effector_pose.translation)
        rates = self.v[6:] / self.sms.limits.velocity
        observation = np.concatenate(
            [np.sin(joints), np.cos(joints), rates, displacement, self.v[:6]], dtype=np.float32
        )
        bounds = self.observation_space
        return np.clip(observation, bounds.low, bounds.high), float(np.linalg.norm(displacement))

    def reset(self, *, seed=None, options=None):
        """Start at rest; the target is the tool position at random joint positions."""
        super().reset(seed=seed)
        self.t, self.q, self.v = 0.0, self.sms.home(), np.zeros(self.sms.nv)
        self.q_d, self.qd_d = self.sms.joint_positions(self.q), np.zeros(self.sms.n)
        goal = self.sms.configuration(self.q_d + self.np_random.uniform(-1.0, 1.0, self.sms.n))
        self.target = np.array(self.sms.at(goal).end_effector_pose.translation)
        observation, self.distance = self.observe()
        return observation, {"distance": self.distance}

    def step(self, action):
        """Follow an action for `dt`; the reward is the decrease of the distance [m], and 1 on arrival."""
        limits, h = self.sms.limits, self.dt / self.substeps
        a = limits.acceleration
        for _ in range(self.substeps):
            left = np.maximum([self.q_d - limits.lower, limits.upper - self.q_d], 0.0)
            slow = np.maximum(np.sqrt(2.0 * a * left) - a * h, 0.0)  # joints can stop at their limits
            wanted = np.clip(action * limits.velocity, -slow[0], slow[1])
            change = np.clip(wanted - self.qd_d, -a * h, a * h)
            tau = self.controller.torque(self.q, self.v, self.q_d, self.qd_d, change / h)
            force = np.concatenate(
                [np.zeros(6), np.clip(tau, -limits.torque, limits.torque)]
            )  # no force on the base
            self.q, self.v, _ = rk4_step(self.sms.model, self.data, self.q, self.v, force, h)
            self.q_d = self.q_d + h * (self.qd_d + 0.5 * change)
            self.qd_d = self.qd_d + change
        self.t, before = self.t + self.dt, self.distance
        observation, self.distance = self.observe()
        arrived = self.distance <= 0.02
        reward = before - self.distance + float(arrived)
        return observation, reward, arrived, self.t > 20.0, {"distance": self.distance}


if __name__ == "__main__":
    sms = ffsms.load("planar_3r")
    env = ReachEnv(sms)
    check_env(env, skip_render_check=True)
    for seed in range(3):
        _, info = env.reset(seed=seed)
        start, total, arrived, over = info["distance"], 0.0, False, False
        while not (arrived or over):
            displacement = env.target - sms.at(env.q).end_effector_pose.translation
            rates = 2.0 * np.linalg.pinv(sms.at(env.q).J_star[:3], rcond=0.05) @ displacement
            action = np.clip(rates / sms.limits.velocity, -1.0, 1.0).astype(np.float32)
            _, reward, arrived, over, _ = env.step(action)
            total += reward
        print(f"distance {start:.2f} m: arrived {arrived} in {env.t:.1f} s, reward {total:.2f}")
        assert arrived
        assert np.abs(sms.at(env.q, env.v).momentum).max() < 1e-10  # no external force
