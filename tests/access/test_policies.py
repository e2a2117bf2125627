"""Decisions of `r4 access check` against pycasbin, over an exhaustively enumerated space of policies and requests.

Policies: every set of pairs of role and item that rules join (2 roles, 2 items), every set of the purposes of the items, and of those with
consent (2 purposes). Requests: every set of roles, item, purpose and action, and each combination of token, retention, hour and emergency.
`r4` reads the policy as TOML, pycasbin as its own model and tuples; both are written here from the same sets. `r4` is the program that
R4_PROGRAM names.
"""

import concurrent.futures
import itertools
import json
import os
import pathlib
import subprocess
import tempfile

import casbin
import pytest

PROGRAM = os.environ["R4_PROGRAM"]
# Any Ed25519 key: test 1 of RFC 8032. No token is signed here.
KEY = "11qYAYKxCrfVS_7TyWQHOg7hcvPapiMlrwIaaPcHURo"

ROLES = ("operator", "carer", "nurse")
ITEMS = ("recording/monday", "recording/tuesday", "recording/never")
PURPOSES = ("care", "study", "sale")
ACTIONS = ("read", "set")
# 2026-11-28, noon and night; the items are kept from the day before for two days, and used from 8 to 18 hours.
DAY_MS = 1_795_824_000_000
HOUR_MS = 3_600_000
SINCE = "2026-11-27T00:00:00Z"
RETENTION_S = 2 * 24 * 3600

# Roles of a subject by `g`, purposes of an item by `g2`, consents by `g3`, items that exist by `g4`.
MODEL = """
[request_definition]
r = auth, sub, obj, act, purpose, emergency, kept, day
[policy_definition]
p = kind, sub, obj, act
[role_definition]
g = _, _
g2 = _, _
g3 = _, _
g4 = _, _
[policy_effect]
e = some(where (p.eft == allow))
[matchers]
m = r.auth == "yes" && r.kept == "yes" && r.day == "yes" && r.act == p.act && g4(r.obj, p.obj) && g(r.sub, p.sub) \
&& ((p.kind == "rule" && g2(r.obj, r.purpose) && g3(r.obj, r.purpose)) || (p.kind == "glass" && r.emergency == "yes"))
"""


def subsets(things):
    """All subsets of a sequence, as tuples."""
    return [tuple(some) for size in range(len(things) + 1) for some in itertools.combinations(things, size)]


def policies():
    """All policies of the space: pairs of role and item, purposes, consents."""
    pairs = list(itertools.product(ROLES[:2], ITEMS[:2]))
    for rules, purposes in itertools.product(subsets(pairs), subsets(PURPOSES[:2])):
        # A purpose is required, and consents are among the purposes.
        if purposes:
            for consent in subsets(purposes):
                yield rules, purposes, consent


def requests():
    """All requests of the space."""
    switches = itertools.product((True, False), repeat=4)
    for roles, item, purpose, action, (auth, kept, day, emergency) in itertools.product(
        subsets(ROLES), ITEMS, PURPOSES, ACTIONS, switches
    ):
        yield roles, item, purpose, action, auth, kept, day, emergency


def subject(roles):
    return "with-" + "-".join(roles)


def toml(rules, purposes, consent):
    """The policy as `r4` reads it."""
    lines = ['name = "space"', "[break_glass]", 'roles = ["nurse"]', 'actions = ["read"]', 'resources = ["recording"]']
    lines += ["life_s = 600", "rest_s = 3600"]
    for roles in subsets(ROLES):
        lines += ["[[subject]]", f'name = "{subject(roles)}"', f'key = "{KEY}"', f"roles = {json.dumps(roles)}"]
    for item in ITEMS[:2]:
        lines += ["[[item]]", f'resource = "{item}"', f"purposes = {json.dumps(purposes)}", f"consent = {json.dumps(consent)}"]
        lines += [f"retention_s = {RETENTION_S}", f"since = {SINCE}", "hours_utc = [8, 18]"]
    for role, item in rules:
        lines += ["[[rule]]", f'roles = ["{role}"]', 'actions = ["read"]', f'resources = ["{item}"]']
    return "\n".join(lines) + "\n"


def enforcer(rules, purposes, consent):
    """The policy as pycasbin has it."""
    model = casbin.Model()
    model.load_model_from_text(MODEL)
    enforcer = casbin.Enforcer(model)
    for roles in subsets(ROLES):
        for role in roles:
            enforcer.add_grouping_policy(subject(roles), role)
    for item in ITEMS[:2]:
        enforcer.add_named_grouping_policy("g4", item, "all")
        for purpose in purposes:
            enforcer.add_named_grouping_policy("g2", item, purpose)
        for purpose in consent:
            enforcer.add_named_grouping_policy("g3", item, purpose)
    for role, item in rules:
        enforcer.add_policy("rule", role, item, "read")
    enforcer.add_policy("glass", "nurse", "all", "read")
    return enforcer


def ours(policy, folder, asked):
    """Decisions of `r4 access check` about all requests."""
    path = folder / "policy.toml"
    path.write_text(toml(*policy))
    lines = []
    for roles, item, purpose, action, auth, kept, day, emergency in asked:
        # Within the retention or ten days after it, at noon or at three in the night.
        at_ms = DAY_MS + (0 if kept else 240) * HOUR_MS + (12 if day else 3) * HOUR_MS
        line = {"purpose": purpose, "emergency": emergency, "action": action, "resource": item, "at_ms": at_ms}
        lines.append(json.dumps(line | ({"subject": subject(roles)} if auth else {})))
    arguments = [PROGRAM, "access", "check", str(path), "--requests", "-"]
    printed = subprocess.run(arguments, input="\n".join(lines) + "\n", capture_output=True, text=True, check=True).stdout
    return [json.loads(line)["granted"] for line in printed.splitlines()]


def compared(policy):
    """Decisions, grants, wrong grants and wrong denials of a policy over all requests."""
    asked = list(requests())
    word = {True: "yes", False: "no"}
    oracle = enforcer(*policy)
    with tempfile.TemporaryDirectory() as folder:
        granted = ours(policy, pathlib.Path(folder), asked)
    assert len(granted) == len(asked)
    grants = wrong_grants = wrong_denials = 0
    for (roles, item, purpose, action, auth, kept, day, emergency), is_granted in zip(asked, granted):
        words = (word[auth], subject(roles), item, action, purpose, word[emergency], word[kept], word[day])
        expected = oracle.enforce(*words)
        grants += expected
        wrong_grants += is_granted and not expected
        wrong_denials += expected and not is_granted
    return len(asked), grants, wrong_grants, wrong_denials


def test_every_decision_is_the_oracles():
    # pycasbin decides about a thousand times a second: each policy on the next free core.
    with concurrent.futures.ProcessPoolExecutor() as cores:
        counts = [sum(column) for column in zip(*cores.map(compared, policies()))]
    decisions, grants, wrong_grants, wrong_denials = counts
    print(f"{decisions} decisions, {grants} grants; wrong grants {wrong_grants}, wrong denials {wrong_denials}")
    assert (decisions, wrong_grants, wrong_denials) == (128 * 2304, 0, 0)
    assert 0.01 < grants / decisions < 0.1


@pytest.mark.parametrize("change", ["glass", "consent"])
def test_the_comparison_finds_a_difference(tmp_path, change):
    """An oracle of another policy disagrees: the comparison is not blind."""
    rules, purposes, consent = ((ROLES[0], ITEMS[0]),), PURPOSES[:1], PURPOSES[:1]
    oracle = enforcer(rules, purposes, () if change == "consent" else consent)
    if change == "glass":
        oracle.remove_policy("glass", "nurse", "all", "read")
    asked = list(requests())
    granted = ours((rules, purposes, consent), tmp_path, asked)
    word = {True: "yes", False: "no"}
    differ = 0
    for (roles, item, purpose, action, auth, kept, day, emergency), is_granted in zip(asked, granted):
        words = (word[auth], subject(roles), item, action, purpose, word[emergency], word[kept], word[day])
        differ += is_granted != oracle.enforce(*words)
    assert differ > 0
