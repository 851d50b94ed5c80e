"""Message definitions in bags are complete; whether readers take them: tests/test_bag_types.py."""

from pathlib import Path
import re

from humanopts_teach.bags import SchemaError
from humanopts_teach.bags.schemas import constants, field_lines, find_schema, SEPARATOR
import pytest


def test_a_schema_holds_every_dependency_once() -> None:
    schema = find_schema('humanopts_interfaces/srv/RunOption_Event')
    names = re.findall(r'^MSG: (\S+)$', schema, re.M)
    assert sorted(names) == [
        'builtin_interfaces/Time',
        'humanopts_interfaces/OptionResult',
        'humanopts_interfaces/RunOption_Request',
        'humanopts_interfaces/RunOption_Response',
        'service_msgs/ServiceEventInfo',
        'std_msgs/Header',
    ]


def test_constants_defaults_and_comments_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / 'share' / 'some_msgs' / 'msg'
    folder.mkdir(parents=True)
    text = '# A thing.\nuint8 KIND_A=1 # first\nint32 LOW = -2\nuint8 kind 1\nPart[] parts\n'
    (folder / 'Thing.msg').write_text(text)
    (folder / 'Part.msg').write_text('string<=5 name "x"')
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    schema = find_schema('some_msgs/msg/Thing')
    assert schema == f'{text}{SEPARATOR}\nMSG: some_msgs/Part\nstring<=5 name "x"\n'
    assert constants(schema, 'KIND_') == {1: 'A'}
    assert constants(schema, '') == {1: 'KIND_A', -2: 'LOW'}
    assert field_lines(schema) == [('uint8', 'kind'), ('Part[]', 'parts')]


@pytest.mark.parametrize(
    ('name', 'reason'),
    [
        ('no_such_msgs/msg/Thing', 'install or build no_such_msgs'),
        ('std_srvs/srv/Trigger_Feedback', 'not a message made of std_srvs/Trigger'),
        ('std_srvs/srv/NoSuch_Event', 'install or build std_srvs'),
        ('String', 'not a type name'),
    ],
)
def test_a_type_that_is_not_there_is_named(name: str, reason: str) -> None:
    with pytest.raises(SchemaError, match=reason):
        find_schema(name)
