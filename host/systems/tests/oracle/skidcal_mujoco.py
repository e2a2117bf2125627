"""Oracle for the tests of r4-systems: a skid-steer car in MuJoCo drives SKIDCAL's two tests.

Writes skidcal_mujoco.json beside itself. Needs: pip install mujoco==3.17.0 numpy

Wheels are heavy spheres on hinges, so that their speed is given. Below its limit MuJoCo's friction is viscous: the force of a contact
times the constraint's regularisation R equals damping times the slip velocity, after a transient of 1 / damping (0.2 ms at 0.3 m/s).
Like Gazebo's wheel_slip plugin with ODE's slip, each step sets the damping of each contact to R / (c |v_rim|), so that
F = v_slip / (c |v_rim|) along a wheel and across it. The resulting c of the car is not taken from that formula but measured in MuJoCo:
the rolling car is towed, and its slip is read off ("towed").
MuJoCo has one damping for both directions of a contact, so c_lat = c_long: the ratio is 1.
"""

import json
import math
import pathlib
import platform

import mujoco
import numpy as np

G = 9.80665
MASS, INERTIA, RADIUS, BASE, TRACK, FRICTION = 11.0, 0.22, 0.056, 0.12, 0.151, 10.0
STEP = 0.00025
COMPLIANCE = 0.015
# Inertia of the wheels, kg m^2: so large that the tyres' forces do not change their speed.
ARMATURE = 1e3
# Upper bound of the damping: a tyre whose rim hardly turns holds.
SLOWEST_M_S = 0.02
SPEED_MAX = 0.5
NAMES = [("fl", BASE, TRACK), ("fr", BASE, -TRACK), ("rl", -BASE, TRACK), ("rr", -BASE, -TRACK)]


class Car:
    def __init__(self):
        wheels = "".join(f"""
      <body name="{n}" pos="{x} {y} {RADIUS}">
        <joint name="{n}" axis="0 1 0" armature="{ARMATURE}"/>
        <inertial pos="0 0 0" mass="0.001" diaginertia="1e-5 1e-5 1e-5"/>
        <geom name="{n}" type="sphere" size="{RADIUS}" contype="0" conaffinity="0" mass="0"/>
      </body>""" for n, x, y in NAMES)
        pairs = "".join(f'<pair geom1="floor" geom2="{n}" condim="3" friction="{FRICTION} {FRICTION} 0 0 0" '
                        f'solimp="0.9 0.9 0.001" solref="0.01 1" solreffriction="-1 -100"/>' for n, _, _ in NAMES)
        self.model = mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <option gravity="0 0 -{G}" timestep="{STEP}" integrator="implicitfast" cone="elliptic" iterations="200" tolerance="1e-12"
          impratio="0.001"/>
  <worldbody>
    <geom name="floor" type="plane" size="200 200 1" contype="0" conaffinity="0"/>
    <body name="car">
      <freejoint/>
      <!-- The centre of mass is on the floor: no load is transferred, as in the paper's law. -->
      <inertial pos="0 0 0" mass="{MASS}" diaginertia="0.15 0.15 {INERTIA}"/>{wheels}
    </body>
  </worldbody>
  <contact>{pairs}</contact>
</mujoco>""")
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.travel = np.zeros(4)
        self.forward_before = 0.0
        for _ in range(4000):
            self.step(np.zeros(4))
        self.travel[:] = self.data.qpos[7:11] * RADIUS

    def step(self, rims, pull=0.0):
        """Makes one step with the rims at these speeds, m/s, and a force that pulls the car forwards, N."""
        data = self.data
        for contact in data.contact:
            if contact.efc_address < 0:
                continue
            wheel = int(contact.geom[1] if self.model.geom(int(contact.geom[0])).name == "floor" else contact.geom[0])
            index = [n for n, _, _ in NAMES].index(self.model.geom(wheel).name)
            rim = max(abs(data.qvel[6 + index]) * RADIUS, SLOWEST_M_S)
            regularisation = data.efc_R[contact.efc_address + 1]
            impedance = 0.9
            self.model.pair_solreffriction[index] = [-1.0, -regularisation / (COMPLIANCE * rim) * impedance]
        # Torque that brings the wheels to their speed within the step.
        data.qfrc_applied[6:10] = ARMATURE * (np.asarray(rims) / RADIUS - data.qvel[6:10]) / STEP
        data.xfrc_applied[1, 0] = pull
        mujoco.mj_step(self.model, data)

    def pose(self):
        w, _, _, z = self.data.qpos[3:7]
        return self.data.qpos[0], self.data.qpos[1], 2 * math.atan2(z, w)

    def forward(self):
        yaw = self.pose()[2]
        return math.cos(yaw) * self.data.qvel[0] + math.sin(yaw) * self.data.qvel[1]


def towed(rim):
    """Measures the compliance, 1/N, by the change of the slip between two steady pulls. A difference is used because wheels that sink in
    roll on a smaller radius."""
    def slip(pull):
        car, speed = Car(), 0.0
        for _ in range(int(1.5 / STEP)):
            speed = min(rim, speed + STEP)
            car.step([speed] * 4, pull)
        return car.forward() - np.mean(car.data.qvel[6:10]) * RADIUS
    return (slip(6.0) - slip(2.0)) / rim / (4.0 / 4)


class Driver:
    """Drives with rims that follow ramps of 1 m/s^2."""

    def __init__(self):
        self.car, self.rims, self.time, self.unwrapped = Car(), np.zeros(4), 0.0, 0.0

    def hold(self, wanted, seconds, run=None):
        for number in range(round(seconds / STEP)):
            if run is not None and number % 40 == 0:
                travel = self.car.data.qpos[7:11] * RADIUS
                run["wheels"].append([self.time, (travel[0] + travel[2]) / 2, (travel[1] + travel[3]) / 2])
                if len(run["wheels"]) % 5 == 1:
                    x, y, yaw = self.car.pose()
                    self.unwrapped += (yaw - self.unwrapped + math.pi) % (2 * math.pi) - math.pi
                    run["tracked"].append([self.time, x, y, self.unwrapped])
            self.rims += np.clip(np.asarray(wanted) - self.rims, -STEP, STEP)
            before = self.car.forward()
            self.car.step(self.rims)
            self.time += STEP
            if run is not None and number % 40 == 39:
                run["felt"].append([self.time, (self.car.forward() - before) / STEP])


def main():
    compliances = [towed(rim) for rim in (0.15, 0.3, 0.47)]
    print("towed", compliances)
    driver = Driver()
    straight = []
    for way in (1, -1):
        driver.hold([way * 0.3 * SPEED_MAX] * 4, 1.4)
        run = dict(wheels=[], tracked=[], felt=[])
        for share, seconds in [(0.3, 0.3), (0.94, 0.8), (0.6, 0.8), (0.94, 0.8), (0.3, 0.8)]:
            driver.hold([way * share * SPEED_MAX] * 4, seconds, run)
        straight.append(run)
    rim = TRACK * 1.0
    spin = dict(wheels=[], tracked=[], felt=[])
    driver.hold([-rim, rim, -rim, rim], 3.0)
    driver.hold([-rim, rim, -rim, rim], 20.0, spin)
    spin["felt"] = []
    result = dict(
        versions=dict(mujoco=mujoco.__version__, numpy=np.__version__, python=platform.python_version()),
        mass_kg=MASS, half_m=[BASE, TRACK], wheel_radius_m=RADIUS,
        towed_per_n=compliances, straight=straight, spin=spin,
    )
    def rounded(value):
        if isinstance(value, float):
            return float(f"{value:.7g}")
        if isinstance(value, dict):
            return {key: rounded(item) for key, item in value.items()}
        return [rounded(item) for item in value] if isinstance(value, list) else value
    def plain(value):
        if isinstance(value, (list, tuple)):
            return [plain(item) for item in value]
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        return float(value) if isinstance(value, np.floating) else value
    target = pathlib.Path(__file__).with_name("skidcal_mujoco.json")
    target.write_text(json.dumps(rounded(plain(result)), separators=(",", ":")) + "\n")
    print(target.stat().st_size, "bytes;", "spin rate", (spin["tracked"][-1][3] - spin["tracked"][0][3]) / (spin["tracked"][-1][0] - spin["tracked"][0][0]))


main()
