"""How values become HTML: as Jinja2 and markupsafe have it, only quicker."""

import pytest
from markupsafe import Markup, escape

from league.web import rendering

VALUES = ["", "plain", "<b>", "a & b", "it's", '"', "ʀ – ≈", 7, -3, True, None, 2.5, 1e-9, [1, "<"]]


@pytest.mark.parametrize("value", [*VALUES, Markup("<b>&amp;</b>"), float("nan")], ids=repr)
def test_values_are_shown_as_markupsafe_escapes_them(value):
    assert str(rendering.shown(value)) == str(escape(value))


@pytest.mark.parametrize("value", VALUES, ids=repr)
def test_templates_escape_every_value(value):
    template = rendering.environment().from_string("<i>{{ value }}</i>{{ {'a': value}.a }}")
    assert template.render(value=value) == f"<i>{escape(value)}</i>{escape(value)}"


def test_methods_of_mappings_come_before_their_keys():
    template = rendering.environment().from_string(
        "{% for name, one in it.items() %}{{ name }}={{ one }};{% endfor %}{{ it.get('own') }}"
    )
    assert template.render(it={"own": 1, "items": 2}) == "own=1;items=2;1"
