"""Oracle for the tests of r4-systems: two hinged fingers in MuJoCo hold a cylinder or a square bar and perform INHAND's two motions.

Writes inhand_mujoco.json beside itself. Needs: pip install mujoco==3.17.0 numpy

Fingers are boxes on hinges, whose bases are on slides with prescribed positions; a stiff spring drives the left finger, a torque presses
the right one. The object moves in the plane without weight. Friction and rolling are MuJoCo's own (elliptic cones, condim 3). At each
stop the file has the true joint angles, the palm and both contact points as MuJoCo reports them: no encoder, no play. No code is shared
with r4-world.
"""

import json
import math
import pathlib
import platform

import mujoco
import numpy as np

W, LENGTH, STEP = 0.008, 0.13, 0.0005
SHARES = [0, .2, .4, .6, .8, 1, .8, .6, .4, .2, 0, -.2, -.4, -.6, -.8, -1, -.8, -.6, -.4, -.2, 0]
TORQUE = 0.3


def run(shape, across, lean, height):
    palm = across + 2 * (W + 0.078 * lean)
    if shape == "disc":
        geom = f'<geom name="object" type="cylinder" size="{across / 2} 0.02" mass="0.06"/>'
    else:
        half = across / 2 / math.sqrt(2)
        geom = f'<geom name="object" type="box" size="{half} {half} 0.02" mass="0.06" euler="0 0 45"/>'
    def finger(name, sign):
        return f"""
    <body name="{name}" pos="{sign * palm / 2} 0 0">
      <joint name="{name}_base" type="slide" axis="1 0 0" damping="200"/>
      <geom type="sphere" size="0.002" mass="0.05" contype="0" conaffinity="0"/>
      <body name="{name}_link">
        <joint name="{name}" type="hinge" axis="0 0 1" damping="0.02" armature="2e-4"/>
        <geom name="{name}" type="box" pos="0 {LENGTH / 2} 0" size="{W} {LENGTH / 2} 0.01" mass="0.04"/>
      </body>
    </body>"""
    contact = "".join(f'<pair geom1="{n}" geom2="object" condim="3" friction="0.9 0.9 0.005 0.0001 0.0001" '
                      f'solref="0.002 1" solimp="0.99 0.999 0.0001"/>' for n in ("left", "right"))
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <option gravity="0 0 0" timestep="{STEP}" integrator="implicitfast" cone="elliptic" iterations="100" tolerance="1e-12" impratio="100"
          noslip_iterations="20"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>{finger("left", -1)}{finger("right", 1)}
    <body name="object" pos="0 {height} 0">
      <joint type="slide" axis="1 0 0" damping="0.5"/><joint type="slide" axis="0 1 0" damping="0.5"/>
      <joint type="hinge" axis="0 0 1" damping="1e-4"/>
      {geom}
    </body>
  </worldbody>
  <contact>{contact}</contact>
  <actuator>
    <position joint="left_base" kp="20000" kv="100"/><position joint="right_base" kp="20000" kv="100"/>
    <position joint="left" kp="200" kv="2"/><motor joint="right"/>
  </actuator>
</mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[1], data.qpos[3] = 0.1, -0.1
    mujoco.mj_forward(model, data)
    aim = [0.0, 0.1]  # opening of the palm, angle of the left finger

    def go(to, seconds):
        start = list(aim)
        count = round(seconds / STEP)
        for number in range(count):
            part = (number + 1) / count
            aim[:] = [s + part * (t - s) for s, t in zip(start, to)]
            # The set point of the left spring leads, so that it holds the torque of the right finger.
            data.ctrl[:] = [-aim[0] / 2, aim[0] / 2, aim[1] - TORQUE / 200, TORQUE]
            mujoco.mj_step(model, data)

    def seen():
        mujoco.mj_forward(model, data)
        width = palm - data.qpos[0] + data.qpos[2]
        places = {"left": [], "right": []}
        for number, contact in enumerate(data.contact):
            force = np.zeros(6)
            mujoco.mj_contactForce(model, data, number, force)
            name = model.geom(int(contact.geom[0])).name
            name = name if name != "object" else model.geom(int(contact.geom[1])).name
            places[name].append((force[0], contact.pos[:2].copy()))
        base = {"left": np.array([-palm / 2 + data.qpos[0], 0]), "right": np.array([palm / 2 + data.qpos[2], 0])}
        mean = {n: sum(f * p for f, p in v) / sum(f for f, _ in v) for n, v in places.items()}
        distance = [float(np.linalg.norm(mean[n] - base[n])) for n in ("left", "right")]
        size = float(np.linalg.norm(mean["right"] - mean["left"]))
        return [width, math.pi / 2 + data.qpos[1], math.pi / 2 + data.qpos[3], *distance, size]

    # Close until the left finger has the lean of the grasp.
    go([0.0, -lean], 0.6)
    go([0.0, -lean], 0.4)
    stops = []
    for share in SHARES:
        to = [0.015 * share, -lean - 0.5 * 0.015 * share / 0.08]
        go(to, 0.15)
        go(to, 0.25)
        stops.append(seen())
    for share in SHARES:
        to = [0.0, -lean + math.radians(10) * share]
        go(to, 0.15)
        go(to, 0.25)
        stops.append(seen())
    return dict(shape=shape, across_m=across, stops=stops)


def main():
    grasps = [run("disc", 0.020, 0.09, 0.078), run("disc", 0.030, 0.09, 0.080), run("disc", 0.042, 0.08, 0.074),
              run("bar", 0.030, 0.08, 0.080), run("bar", 0.040, 0.08, 0.074)]
    result = dict(versions=dict(mujoco=mujoco.__version__, numpy=np.__version__, python=platform.python_version()), half_width_m=W,
                  grasps=grasps)
    def rounded(value):
        if isinstance(value, (float, np.floating)):
            return float(f"{float(value):.8g}")
        if isinstance(value, dict):
            return {key: rounded(item) for key, item in value.items()}
        return [rounded(item) for item in value] if isinstance(value, list) else value
    target = pathlib.Path(__file__).with_name("inhand_mujoco.json")
    target.write_text(json.dumps(rounded(result), separators=(",", ":")) + "\n")
    for grasp in grasps:
        stops = np.array(grasp["stops"])
        print(grasp["shape"], grasp["across_m"], "first", stops[0].round(4), "left contact", np.ptp(stops[:, 3]).round(4))


main()
