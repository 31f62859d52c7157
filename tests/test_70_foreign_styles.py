"""QML and SLD: what they say of lines, fills, marks, classes and names, and that the rest is told."""

from __future__ import annotations

from pathlib import Path

import pytest
from page_rig import page_of
from shapely import Point

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import parse_crs
from geomosaic.sheets.inputs import foreign_style, read_style, vector_input
from geomosaic.sheets.style import Fill, Label, Line, Marker, Symbol
from geomosaic.sheets.vector_layers import overlay

SINGLE = """<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.34"><renderer-v2 type="singleSymbol"><symbols>
<symbol type="line" name="0" alpha="0.5">
 <layer class="SimpleLine" enabled="1"><Option type="Map">
  <Option name="line_color" value="30,31,32,255" type="QString"/><Option name="line_width" value="1.2" type="QString"/>
  <Option name="line_width_unit" value="MM" type="QString"/><Option name="line_style" value="solid" type="QString"/>
 </Option></layer>
 <layer class="SimpleLine" enabled="1"><Option type="Map">
  <Option name="line_color" value="255,0,128,255,rgb:1,0,0.5,1" type="QString"/>
  <Option name="line_width" value="2" type="QString"/><Option name="line_width_unit" value="Point" type="QString"/>
  <Option name="line_style" value="dash" type="QString"/></Option></layer>
 <layer class="SimpleLine" enabled="0"><Option type="Map"/></layer>
 <layer class="MarkerLine" enabled="1"><Option type="Map"/></layer>
</symbol></symbols></renderer-v2>
<labeling type="simple"><settings><text-style fieldName="name" fontSize="8" fontSizeUnit="Point" textColor="0,0,255,255"
 fontWeight="75" fontItalic="1">
 <text-buffer bufferDraw="1" bufferSize="0.7" bufferColor="250,250,250,255"/></text-style>
</settings></labeling></qgis>"""

CLASSES = """<qgis version="3.4"><renderer-v2 type="{kind}" attr="{attr}">
{classes}
<symbols>
<symbol type="fill" name="0" alpha="1"><layer class="SimpleFill" enabled="1"><prop k="color" v="10,20,30,51"/>
 <prop k="style" v="solid"/><prop k="outline_color" v="1,2,3,255"/><prop k="outline_width" v="0.3"/>
 <prop k="outline_style" v="no"/></layer></symbol>
<symbol type="marker" name="1" alpha="1"><layer class="SimpleMarker" enabled="1">
 <prop k="name" v="equilateral_triangle"/>
 <prop k="color" v="9,8,7,255"/><prop k="size" v="3"/><prop k="outline_color" v="255,255,255,255"/>
 <prop k="outline_width" v="0.2"/></layer></symbol>
</symbols></renderer-v2></qgis>"""


def test_qml_lines_with_casing_and_names() -> None:
    style, told = foreign_style(SINGLE, "x.qml")
    pink = 2 * 25.4 / 72
    line = style.symbol.line
    assert line is not None
    assert (line.color, line.width) == ("#ff0080", pytest.approx(pink))
    assert (line.casing, line.casing_width) == ("#1e1f20", 1.2)
    assert line.dash == pytest.approx((4 * pink, 2 * pink))
    assert line.opacity == 0.5
    assert style.label == Label("name", 8.0, "#0000ff", "#fafafa", 0.7, True, True)
    assert told == ["symbol layer 'MarkerLine'"]


def test_qml_categories_and_classes() -> None:
    categories = (
        '<categories><category symbol="0" value="wood" label="Wood" render="true"/>'
        '<category symbol="1" value="7" label="Seven" render="false"/>'
        '<category symbol="1" value="" label="" render="true"/></categories>'
    )
    style, told = foreign_style(CLASSES.format(kind="categorizedSymbol", attr="kind", classes=categories), "x.qml")
    assert told == []
    assert style.column == "kind"
    wood, seven = style.rules
    assert (wood.value, wood.title, wood.fill, wood.line) == ("wood", "Wood", Fill("#0a141e", 0.2), None)
    assert (seven.value, seven.hide) == ("7", True)
    assert style.symbol == Symbol(marker=Marker("triangle", 3.0, "#090807", "#ffffff", 0.2))
    ranges = (
        '<ranges><range symbol="0" lower="0" upper="10" label="low"/>'
        '<range symbol="1" lower="10" upper="25.5" label="high"/></ranges>'
    )
    style, _ = foreign_style(CLASSES.format(kind="graduatedSymbol", attr="height", classes=ranges), "x.qml")
    low, high = style.rules
    assert (low.least, high.least) == (0.0, 10.0)
    # Upper limits belong to their classes, in QGIS as here.
    assert low.below is not None
    assert high.below is not None
    assert 10.0 < low.below < 10.0001
    assert 25.5 < high.below < 25.5001
    style, told = foreign_style(CLASSES.format(kind="RuleRenderer", attr="", classes=""), "x.qml")
    assert style.symbol.fill == Fill("#0a141e", 0.2)
    assert "RuleRenderer" in told[0]


SLD = """<StyledLayerDescriptor version="{version}" xmlns="http://www.opengis.net/sld" xmlns:se="http://www.opengis.net/se"
 xmlns:ogc="http://www.opengis.net/ogc"><NamedLayer><UserStyle><FeatureTypeStyle>
<Rule><Name>major</Name><ogc:Filter><ogc:PropertyIsEqualTo><ogc:PropertyName>class</ogc:PropertyName>
 <ogc:Literal>A</ogc:Literal></ogc:PropertyIsEqualTo></ogc:Filter>
 <LineSymbolizer><Stroke><{css} name="stroke">#333333</{css}><{css} name="stroke-width">5</{css}>
 </Stroke></LineSymbolizer>
 <LineSymbolizer><Stroke><{css} name="stroke">#FFCC00</{css}><{css} name="stroke-width">3</{css}>
  <{css} name="stroke-dasharray">10 5</{css}></Stroke></LineSymbolizer></Rule>
<Rule><MaxScaleDenominator>5000</MaxScaleDenominator>
 <PolygonSymbolizer><Fill><{css} name="fill">#00FF00</{css}><{css} name="fill-opacity">0.3</{css}>
 </Fill></PolygonSymbolizer>
 <TextSymbolizer><Label><ogc:PropertyName>label</ogc:PropertyName></Label><Font><{css} name="font-size">12</{css}>
  <{css} name="font-weight">bold</{css}></Font><Halo><Radius>2</Radius></Halo></TextSymbolizer>
 <PointSymbolizer><Graphic><Mark><WellKnownName>x</WellKnownName><Fill><{css} name="fill">#112233</{css}></Fill></Mark>
  <Size>10</Size></Graphic></PointSymbolizer></Rule>
<Rule><Name>odd</Name><ogc:Filter><ogc:PropertyIsLike><ogc:PropertyName>class</ogc:PropertyName>
 <ogc:Literal>B*</ogc:Literal></ogc:PropertyIsLike></ogc:Filter><LineSymbolizer/></Rule>
</FeatureTypeStyle></UserStyle></NamedLayer></StyledLayerDescriptor>"""


@pytest.mark.parametrize(("version", "css"), [("1.0.0", "CssParameter"), ("1.1.0", "se:SvgParameter")])
def test_an_sld_is_read_and_the_rest_reported(version: str, css: str) -> None:
    """Pixels are 0.28 mm; two strokes are a line with its casing; what is not understood is told, each once."""
    style, told = foreign_style(SLD.format(version=version, css=css), "x.sld")
    assert style.column == "class"
    (rule,) = style.rules
    assert (rule.value, rule.title) == ("A", "major")
    want = Line("#ffcc00", 3 * 0.28, (2.8, 1.4), "#333333", 5 * 0.28)
    assert rule.line is not None
    assert (rule.line.color, rule.line.casing) == (want.color, want.casing)
    assert (rule.line.width, *rule.line.dash, rule.line.casing_width) == pytest.approx(
        (want.width, *want.dash, want.casing_width)
    )
    assert style.symbol.fill == Fill("#00ff00", 0.3)
    assert style.symbol.marker is not None
    assert (style.symbol.marker.shape, style.symbol.marker.color) == ("cross", "#112233")
    assert style.symbol.marker.size == pytest.approx(2.8)
    assert style.label is not None
    assert (style.label.column, style.label.bold, style.label.halo) == ("label", True, "#ffffff")
    assert style.label.size == pytest.approx(12 * 0.28 / (25.4 / 72))
    assert len(told) == 3
    assert any("without filter" in text for text in told)
    assert any("MaxScaleDenominator" in text for text in told)
    assert any("odd" in text for text in told)


def test_classes_of_an_sld_are_drawn() -> None:
    text = """<StyledLayerDescriptor><UserStyle><FeatureTypeStyle><Rule><Title>mid</Title><Filter><And>
     <PropertyIsGreaterThanOrEqualTo><PropertyName>h</PropertyName><Literal>10</Literal></PropertyIsGreaterThanOrEqualTo>
     <PropertyIsLessThan><PropertyName>h</PropertyName><Literal>20</Literal></PropertyIsLessThan></And></Filter>
     <PolygonSymbolizer uom="http://www.opengeospatial.org/se/units/metre"><Fill/></PolygonSymbolizer></Rule>
     </FeatureTypeStyle></UserStyle></StyledLayerDescriptor>"""
    style, told = foreign_style(text, "x.sld")
    assert (style.column, style.rules[0].least, style.rules[0].below) == ("h", 10.0, 20.0)
    assert "metre" in told[0]


def test_files_are_read_by_their_names(tmp_path: Path) -> None:
    (tmp_path / "s.qml").write_text(SINGLE)
    with pytest.warns(GeomosaicWarning, match="MarkerLine"):
        style = read_style("s.qml", tmp_path)
    assert style.label is not None
    (tmp_path / "s.sld").write_text(SLD.format(version="1.0.0", css="CssParameter"))
    (tmp_path / "v.gpkg").touch()
    with pytest.warns(GeomosaicWarning):
        found = vector_input(f"v.gpkg#roads:{'s.sld'}", tmp_path)
    assert found.layer == "roads"
    assert found.style is not None
    assert found.style.column == "class"


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("not xml", "no XML"), ("<html/>", "neither"), ("<qgis/>", "draws nothing"),
        ('<!DOCTYPE x [<!ENTITY a "b">]><qgis/>', "entities"),
        (SINGLE.replace('value="1.2"', 'value="wide"'), "number"),
        ("<StyledLayerDescriptor/>", "draws nothing"),
    ],
)  # fmt: skip
def test_what_cannot_be_read(text: str, part: str) -> None:
    with pytest.raises(InputError, match=part):
        foreign_style(text, "x")


MARKED = """<qgis version="3.34" labelsEnabled="{labels}" hasScaleBasedVisibilityFlag="1">
<renderer-v2 type="categorizedSymbol" attr="kind"><categories>
<category symbol="0" type="List" label="Woods">
<val type="QString" value="wood"/><val type="QString" value="7"/></category>
</categories><symbols><symbol type="marker" name="0" alpha="0.5">
<layer class="SimpleMarker" enabled="1"><Option type="Map">
<Option name="color" value="10,20,30,128"/><Option name="offset" value="0,1.5"/><Option name="angle" value="30"/>
<Option name="outline_style" value="no"/></Option></layer></symbol></symbols></renderer-v2>
<layerOpacity>0.7</layerOpacity><blendMode>6</blendMode>
<labeling type="simple"><settings><text-style fieldName="&quot;name&quot;" isExpression="1" fontWeight="100"/>
</settings></labeling></qgis>"""


def test_qml_merged_values_and_what_is_not_drawn() -> None:
    style, told = foreign_style(MARKED.format(labels=1), "x.qml")
    assert [(rule.value, rule.title) for rule in style.rules] == [("wood", "Woods"), ("7", "Woods")]
    assert style.symbol == Symbol()
    marker = style.rules[0].marker
    assert marker is not None
    assert marker.opacity == pytest.approx(0.5 * 128 / 255)
    assert style.label is not None
    assert (style.label.column, style.label.bold) == ("name", True)
    for words in ("offset of", "angle of", "opacity 0.7", "blendMode", "scales"):
        assert any(words in remark for remark in told), words
    # Labels that are switched off stay in the file.
    assert foreign_style(MARKED.format(labels=0), "x.qml")[0].label is None


ROADS = """<StyledLayerDescriptor version="1.0.0" xmlns="http://www.opengis.net/sld" xmlns:ogc="http://www.opengis.net/ogc">
<NamedLayer><UserStyle>
<FeatureTypeStyle><Rule><LineSymbolizer><Stroke><CssParameter name="stroke">#333333</CssParameter>
 <CssParameter name="stroke-width">5</CssParameter></Stroke></LineSymbolizer></Rule></FeatureTypeStyle>
<FeatureTypeStyle><Rule><LineSymbolizer><Stroke><CssParameter name="stroke">#6699FF</CssParameter>
 <CssParameter name="stroke-width">3</CssParameter></Stroke>
 <PerpendicularOffset>2</PerpendicularOffset></LineSymbolizer></Rule></FeatureTypeStyle>
</UserStyle></NamedLayer></StyledLayerDescriptor>"""


def test_sld_casing_in_a_layer_of_its_own() -> None:
    """The usual way of drawing roads in SLD: all wide strokes below, then all narrow ones."""
    style, told = foreign_style(ROADS, "x.sld")
    line = style.symbol.line
    assert line is not None
    assert (line.color, line.casing) == ("#6699ff", "#333333")
    assert line.casing_width == pytest.approx(5 * 0.28)
    assert told == ["PerpendicularOffset of a LineSymbolizer"]


EITHER = """<StyledLayerDescriptor version="1.0.0" xmlns="http://www.opengis.net/sld" xmlns:ogc="http://www.opengis.net/ogc">
<NamedLayer><UserStyle><FeatureTypeStyle>
<Rule><Title>Main</Title><ogc:Filter><ogc:Or>
<ogc:PropertyIsEqualTo><ogc:PropertyName>c</ogc:PropertyName><ogc:Literal>1.0</ogc:Literal></ogc:PropertyIsEqualTo>
<ogc:PropertyIsEqualTo><ogc:PropertyName>c</ogc:PropertyName><ogc:Literal>B</ogc:Literal></ogc:PropertyIsEqualTo>
</ogc:Or></ogc:Filter><PolygonSymbolizer><Fill/></PolygonSymbolizer></Rule>
<Rule><TextSymbolizer><Label><ogc:PropertyName>a</ogc:PropertyName> m<ogc:PropertyName>b</ogc:PropertyName></Label>
</TextSymbolizer></Rule>
</FeatureTypeStyle></UserStyle></NamedLayer></StyledLayerDescriptor>"""


def test_sld_either_or() -> None:
    style, told = foreign_style(EITHER, "x.sld")
    assert [(rule.value, rule.title) for rule in style.rules] == [("1.0", "Main"), ("B", "Main")]
    assert told == ["labels that are not one property"]
    shapes = [Point(x, 5.0).buffer(1.0) for x in (2.0, 5.0, 8.0)]
    cells: list[object] = [1, "B", "C"]
    map_crs = parse_crs("EPSG:32633")
    made = overlay(shapes, {"c": cells}, map_crs, style, "x", page_of(map_crs, (0, 0, 10, 10), 1.0), where="x")
    assert [(group.title, len(group.geometries)) for group in made.groups] == [("Main", 2)]
    assert "1 of 3 objects" in made.notes[0]


ONE_RULE = (
    '<StyledLayerDescriptor version="1.0.0" xmlns="http://www.opengis.net/sld" xmlns:ogc="http://www.opengis.net/ogc">'
    "<NamedLayer><UserStyle><FeatureTypeStyle><Rule>{}</Rule></FeatureTypeStyle></UserStyle></NamedLayer>"
    "</StyledLayerDescriptor>"
)


def test_sld_literals_expressions_and_solid_lines() -> None:
    """Literals are values, expressions are told, a dash of 0 is a line without gaps, and short colours are read."""
    text = ONE_RULE.format(
        '<PolygonSymbolizer><Fill><CssParameter name="fill"><ogc:Literal>#ff0000</ogc:Literal></CssParameter></Fill>'
        '<Stroke><CssParameter name="stroke">#0a0</CssParameter><CssParameter name="stroke-dasharray">0</CssParameter>'
        '<CssParameter name="stroke-width"><ogc:Mul><ogc:PropertyName>v</ogc:PropertyName><ogc:Literal>2</ogc:Literal>'
        "</ogc:Mul></CssParameter></Stroke></PolygonSymbolizer>"
    )
    style, told = foreign_style(text, "x.sld")
    symbol = style.symbol if style.symbol != Symbol() else Symbol(style.rules[0].line, style.rules[0].fill)
    assert symbol.fill is not None
    assert symbol.fill.color == "#ff0000"
    assert symbol.line is not None
    assert (symbol.line.color, symbol.line.dash) == ("#00aa00", ())
    assert told == ["an expression as stroke-width"]
    negative = text.replace(">0</CssParameter>", ">-1 2</CssParameter>")
    assert any("drawn whole" in remark for remark in foreign_style(negative, "x.sld")[1])


def test_qml_layers_that_are_left_out_are_reported() -> None:
    """A second fill, a third stroke, and what labels have beyond their font."""
    fill = (
        '<layer class="SimpleFill" enabled="1"><prop k="color" v="{},0,0,255"/><prop k="outline_color" v="1,2,3,255"/>'
        '<prop k="outline_width" v="0.5"/><prop k="outline_style" v="{}"/></layer>'
    )
    two = f"""<qgis><renderer-v2 type="singleSymbol"><symbols><symbol type="fill" name="0" alpha="1">
{fill.format(9, "solid")}{fill.format(200, "no")}</symbol></symbols></renderer-v2>
<labeling type="simple"><settings><text-style fieldName="n" fontSize="8" capitalization="1"/>
<background shapeDraw="1"/><rendering scaleVisibility="1"/></settings></labeling></qgis>"""
    style, told = foreign_style(two, "x.qml")
    assert style.symbol.fill is not None
    assert style.symbol.fill.color == "#c80000"
    assert style.symbol.line is not None  # the outline of the lower one
    assert style.symbol.line.width == 0.5
    assert set(told) == {
        "more than one SimpleFill, the last one drawn",
        "capitals of labels",
        "backgrounds of labels",
        "labels at some scales only, drawn at this one",
    }
    stroke = SINGLE[SINGLE.index(' <layer class="SimpleLine"') : SINGLE.index(' <layer class="SimpleLine" enabled="0"')]
    three = SINGLE.replace(stroke, stroke + stroke)
    assert "more than two strokes of a line" in foreign_style(three, "x.qml")[1]


@pytest.mark.parametrize("alpha", ["10000", "-1", "nan"])
def test_an_opacity_out_of_range_is_refused(alpha):
    text = SINGLE_FILL.format(alpha=alpha, color="1,2,3,255")
    with pytest.raises(InputError, match="opacity"):
        foreign_style(text, "a.qml")


def test_a_colour_out_of_range_is_drawn_black_and_told():
    style, remarks = foreign_style(SINGLE_FILL.format(alpha="1", color="300,2,3,255"), "a.qml")
    assert style.symbol.fill.color == "#000000"
    assert any("300,2,3,255" in remark for remark in remarks)


SINGLE_FILL = (
    '<qgis><renderer-v2 type="singleSymbol"><symbols><symbol name="0" alpha="{alpha}"><layer class="SimpleFill">'
    '<prop k="color" v="{color}"/></layer></symbol></symbols></renderer-v2></qgis>'
)
