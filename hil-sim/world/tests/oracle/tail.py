"""Accelerations of a person with a two-link tail by Pinocchio and MuJoCo, for the tests of r4-world.

Writes tail.json beside itself. Needs: pip install pin mujoco==3.17.0 numpy
The model's numbers are those of `oracle_tail` in src/tail/tests.rs; angles turn about y, from z to x.
"""

import json
import pathlib
import platform

import mujoco
import numpy as np
import pinocchio as pin

G = 9.80665
WEARER = dict(mass=72.0, centre=0.97, inertia=80.0, tail=(-0.12, 1.15))
LINKS = [
    dict(length=0.70, mass=3.4, centre=0.45, inertia=0.15),
    dict(length=0.40, mass=3.1, centre=0.31, inertia=0.05),
]
LOAD = dict(mass=10.0, place=(0.35, 1.05))


def pinocchio_model(load):
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])

    def inertia(mass, x, z, about_y):
        # About the centre of mass; only y counts in the plane, the others must make a possible body.
        return pin.Inertia(mass, np.array([x, 0.0, z]), np.diag([about_y, about_y, about_y]))

    trunk = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "trunk")
    own = WEARER["inertia"] - WEARER["mass"] * WEARER["centre"] ** 2
    model.appendBodyToJoint(trunk, inertia(WEARER["mass"], 0, WEARER["centre"], own), pin.SE3.Identity())
    if load:
        model.appendBodyToJoint(trunk, inertia(LOAD["mass"], *LOAD["place"], 0.0), pin.SE3.Identity())
    at = pin.SE3(np.eye(3), np.array([WEARER["tail"][0], 0, WEARER["tail"][1]]))
    parent = trunk
    for number, link in enumerate(LINKS):
        parent = model.addJoint(parent, pin.JointModelRY(), at, f"joint{number + 1}")
        model.appendBodyToJoint(parent, inertia(link["mass"], 0, -link["centre"], link["inertia"]), pin.SE3.Identity())
        at = pin.SE3(np.eye(3), np.array([0, 0, -link["length"]]))
    return model, model.createData()


def mujoco_model(load):
    own = WEARER["inertia"] - WEARER["mass"] * WEARER["centre"] ** 2
    body = '<inertial pos="{x} 0 {z}" mass="{m}" diaginertia="{i} {i} {i}"/>'
    carried = (
        f'<body pos="{LOAD["place"][0]} 0 {LOAD["place"][1]}">'
        + body.format(x=0, z=0, m=LOAD["mass"], i=1e-12)
        + "</body>"
        if load
        else ""
    )
    first, second = LINKS
    return mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <option gravity="0 0 -{G}" integrator="RK4" timestep="0.00025">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>
    <body name="trunk">
      <joint name="trunk" axis="0 1 0"/>
      {body.format(x=0, z=WEARER["centre"], m=WEARER["mass"], i=own)}
      {carried}
      <body pos="{WEARER["tail"][0]} 0 {WEARER["tail"][1]}">
        <joint name="joint1" axis="0 1 0"/>
        {body.format(x=0, z=-first["centre"], m=first["mass"], i=first["inertia"])}
        <body pos="0 0 -{first["length"]}">
          <joint name="joint2" axis="0 1 0"/>
          {body.format(x=0, z=-second["centre"], m=second["mass"], i=second["inertia"])}
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>""")


def main():
    random = np.random.default_rng(24)
    rows = []
    for number in range(40):
        load = number % 2 == 1
        q = random.uniform(-1.5, 1.5, 3)
        v = random.uniform(-4.0, 4.0, 3)
        tau = random.uniform(-100.0, 100.0, 3)
        model, data = pinocchio_model(load)
        by_pinocchio = pin.aba(model, data, q, v, tau)
        mj = mujoco_model(load)
        state = mujoco.MjData(mj)
        state.qpos[:], state.qvel[:], state.qfrc_applied[:] = q, v, tau
        mujoco.mj_forward(mj, state)
        rows.append(
            dict(
                load_kg=LOAD["mass"] if load else 0.0,
                q=q.tolist(),
                v=v.tolist(),
                tau=tau.tolist(),
                pinocchio=by_pinocchio.tolist(),
                mujoco=state.qacc.tolist(),
            )
        )
    # One second of swinging without torques, from rest with both links raised.
    mj = mujoco_model(False)
    state = mujoco.MjData(mj)
    state.qpos[:] = [0.02, 1.2, -0.6]
    path = []
    for step in range(4001):
        if step % 400 == 0:
            path.append(dict(t=step * 0.00025, q=state.qpos.tolist(), v=state.qvel.tolist()))
        mujoco.mj_step(mj, state)
    result = dict(
        versions=dict(pinocchio=pin.__version__, mujoco=mujoco.__version__, numpy=np.__version__, python=platform.python_version()),
        g=G,
        rows=rows,
        path=path,
    )
    target = pathlib.Path(__file__).with_name("tail.json")
    target.write_text(json.dumps(result, indent=1) + "\n")
    print(f"{len(rows)} states, {len(path)} of the path; largest difference of the two:",
          max(np.abs(np.subtract(r["pinocchio"], r["mujoco"])).max() / np.abs(r["pinocchio"]).max() for r in rows))


main()
