"""A four-wheel car in MuJoCo that brakes, rolls on and spins, for the tests of r4-world.

Writes wheeled.json beside itself. Needs: pip install mujoco==3.17.0 numpy
The car's numbers are those of `mujoco_car` in src/wheeled/mujoco.rs. Wheels are spheres, which touch the floor in one point,
on hinges whose speed is given by stiff servos; friction is MuJoCo's elliptic cone in the plane of contact.
"""

import json
import math
import pathlib
import platform

import mujoco
import numpy as np

G = 9.80665
MASS, INERTIA, RADIUS, BASE, TRACK, FRICTION = 9.0, 0.18, 0.056, 0.12, 0.151, 0.8
WHEEL_MASS, WHEEL_INERTIA = 1e-3, 1e-5
STEP = 0.0002


def model(solref=0.02, solimp="0.9 0.95 0.001"):
    """The car; the contact's softness is MuJoCo's own unless said otherwise."""
    wheels = []
    for name, x, y in [("fl", BASE, TRACK), ("fr", BASE, -TRACK), ("rl", -BASE, TRACK), ("rr", -BASE, -TRACK)]:
        wheels.append(f"""
      <body name="{name}" pos="{x} {y} {RADIUS}">
        <joint name="{name}" axis="0 1 0" armature="0.003"/>
        <inertial pos="0 0 0" mass="{WHEEL_MASS}" diaginertia="{WHEEL_INERTIA} {WHEEL_INERTIA} {WHEEL_INERTIA}"/>
        <geom type="sphere" size="{RADIUS}" friction="{FRICTION} 0 0" condim="3" mass="0"/>
      </body>""")
    motors = "".join(f'<velocity joint="{n}" kv="500"/>' for n in ["fl", "fr", "rl", "rr"])
    return mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <option gravity="0 0 -{G}" timestep="{STEP}" integrator="implicitfast" cone="elliptic"
          iterations="200" tolerance="1e-12"/>
  <default><geom solref="{solref} 1" solimp="{solimp}"/></default>
  <worldbody>
    <geom type="plane" size="50 50 1" friction="{FRICTION} 0 0" condim="3"/>
    <body name="car">
      <freejoint/>
      <inertial pos="0 0 0" mass="{MASS}" diaginertia="0.1 0.1 {INERTIA}"/>
      {"".join(wheels)}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>""")


def run(mj, speeds, start=0.0, spin=0.0, seconds=1.0, every=250, rolls=True):
    """Rows of t, x, y, yaw, forward, left, yaw rate. `speeds(t)` are those of the wheels, rad/s."""
    data = mujoco.MjData(mj)
    mujoco.mj_forward(mj, data)
    for _ in range(600):  # settles on its springs
        data.ctrl[:] = 0
        mujoco.mj_step(mj, data)
    x0, y0 = data.qpos[0], data.qpos[1]
    data.qvel[:] = 0
    data.qvel[0] = start
    data.qvel[5] = spin
    if rolls:
        data.qvel[6:] = speeds(0.0)
    rows = []
    for step in range(int(seconds / STEP) + 1):
        w, _, _, z = data.qpos[3:7]
        yaw = 2 * math.atan2(z, w)
        vx, vy = data.qvel[0], data.qvel[1]
        if step % every == 0:
            c, s = math.cos(yaw), math.sin(yaw)
            rows.append([step * STEP, data.qpos[0] - x0, data.qpos[1] - y0, yaw, c * vx + s * vy, c * vy - s * vx, data.qvel[5]])
        data.ctrl[:] = speeds(step * STEP)
        mujoco.mj_step(mj, data)
    return rows


def main():
    mj = model()
    result = dict(
        versions=dict(mujoco=mujoco.__version__, numpy=np.__version__, python=platform.python_version()),
        columns=["t_s", "x_m", "y_m", "yaw_rad", "forward_m_s", "left_m_s", "yaw_rad_s"],
        # Wheels locked at 1.5 m/s.
        brake=run(mj, lambda t: np.zeros(4), start=1.5, seconds=0.5, rolls=False),
        # Wheels spun at 2 m/s of rim under a car at rest: it is pushed off with mu g.
        launch=run(mj, lambda t: np.full(4, 2.0 / RADIUS), seconds=0.5),
        # Wheels locked while the car turns at 6 rad/s: friction of four sliding points.
        twirl=run(mj, lambda t: np.zeros(4), spin=6.0, seconds=0.5, rolls=False),
        # Left wheels back, right wheels forwards, 0.3 m/s of rim each: a turn on the spot.
        spin=run(mj, lambda t: np.array([-1, 1, -1, 1]) * 0.3 / RADIUS, seconds=2.0, every=500),
    )
    target = pathlib.Path(__file__).with_name("wheeled.json")
    rounded = {k: ([[float(f"{v:.9g}") for v in row] for row in rows] if k in ("brake", "launch", "twirl", "spin") else rows)
               for k, rows in result.items()}
    target.write_text(json.dumps(rounded) + "\n")
    for name in ("brake", "launch", "twirl", "spin"):
        print(name, result[name][-1])
    # What the softness of the contact decides: distance, angle and rate at the end, for other numbers of it.
    for solref, solimp in [(0.02, "0.5 0.5 0.001"), (0.02, "0.5 0.95 0.001"), (0.03, "0.9 0.95 0.001"), (0.01, "0.9 0.95 0.001")]:
        other = model(solref, solimp)
        print(solref, solimp, [run(other, lambda t: np.zeros(4), start=1.5, seconds=0.5, rolls=False)[-1][1],
              run(other, lambda t: np.zeros(4), spin=6.0, seconds=0.5, rolls=False)[-1][3],
              run(other, lambda t: np.array([-1, 1, -1, 1]) * 0.3 / RADIUS, seconds=2.0)[-1][6]])


main()
