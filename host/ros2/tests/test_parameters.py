"""Parameters, accessed by rclpy's own client."""

import pytest
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient


@pytest.fixture
def parameters(peer):
    client = AsyncParameterClient(peer.node, "r4")
    assert peer.until(client.services_are_ready), "no parameter services"

    def ask(call, *arguments, **keywords):
        future = getattr(client, call)(*arguments, **keywords)
        assert peer.until(future.done), f"no answer to {call}"
        return future.result()

    return ask


def test_the_configuration_is_listed_read_and_described(parameters):
    # All 151 names are too long for an answer, which then has their prefixes only.
    listed = parameters("list_parameters").result
    assert list(listed.names) == [] and {"board", "dhb0", "dhb3", "supply0"} <= set(listed.prefixes)
    names = [name for prefix in listed.prefixes for name in parameters("list_parameters", prefixes=[prefix]).result.names]
    # Keys of openscout.toml.
    assert len(names) == 151 and {"board.link_timeout_ms", "dhb0.speed_kp", "dhb3.position_max"} <= set(names)
    assert len(parameters("get_parameters", names[:20]).values) == 20
    assert len(parameters("get_parameters", names).values) == 0
    of_wheel = parameters("list_parameters", prefixes=["dhb0"], depth=1).result
    assert of_wheel.names and all(name.startswith("dhb0.") for name in of_wheel.names)
    assert list(of_wheel.prefixes) == ["dhb0"]
    values = parameters("get_parameters", ["board.link_timeout_ms", "dhb0.speed_kp", "nothing"]).values
    assert [value.type for value in values] == [3, 3, 0]
    assert [value.double_value for value in values[:2]] == [200.0, 0.167]
    assert list(parameters("get_parameter_types", ["dhb0.speed_kp", "nothing"]).types) == [3, 0]
    gain, limit = parameters("describe_parameters", ["dhb0.speed_kp", "dhb0.speed_max"]).descriptors
    assert (gain.name, gain.type, gain.read_only) == ("dhb0.speed_kp", 3, False)
    assert "duty s/rad" in gain.description and limit.read_only and "next start" in limit.additional_constraints


def test_gains_are_set_and_the_rest_is_refused(parameters):
    def wanted(**values):
        return [Parameter(name.replace("__", "."), value=value) for name, value in values.items()]

    kept, refused, unknown = parameters(
        "set_parameters", wanted(dhb0__speed_kp=0.2, dhb0__speed_max=5.0, nothing=1.0)
    ).results
    assert kept.successful, kept.reason
    assert not refused.successful and "r4 config set dhb0.speed_max 5 --save" in refused.reason
    assert not unknown.successful and "no parameter nothing" in unknown.reason

    def gain():
        return parameters("get_parameters", ["dhb0.speed_kp"]).values[0].double_value

    assert gain() == 0.2
    half = parameters("set_parameters_atomically", wanted(dhb0__speed_kp=0.3, dhb0__position_kp=-1.0)).result
    assert not half.successful and half.reason and gain() == 0.2
    text = parameters("set_parameters", wanted(dhb0__speed_kp="much")).results[0]
    assert not text.successful and "is a number" in text.reason
    assert parameters("set_parameters_atomically", wanted(dhb0__speed_kp=0.167)).result.successful
    assert gain() == 0.167
