"""CDF 2.0 files as tools of the field write them, built by lxml and held against ASAM's DTD and XSD: every category of the
schema, Latin-1 and UTF-16, a default namespace, labelled groups, members of structures and arrays, variants, words."""
import os
import sys

from lxml import etree

folder, schema = sys.argv[1:3]
XML = "http://www.w3.org/XML/1998/namespace"
stub = f"""<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema" targetNamespace="{XML}">
<xs:attribute name="lang" type="xs:language"/><xs:attribute name="space" type="xs:NCName"/>
<xs:attribute name="base" type="xs:anyURI"/><xs:attribute name="id" type="xs:ID"/>
<xs:attributeGroup name="specialAttrs"><xs:attribute ref="xml:base"/><xs:attribute ref="xml:lang"/>
<xs:attribute ref="xml:space"/><xs:attribute ref="xml:id"/></xs:attributeGroup></xs:schema>"""


class Stub(etree.Resolver):
    def resolve(self, url, public_id, context):
        return self.resolve_string(stub, context) if url.endswith("xml.xsd") else None


def add(parent, tag, text=None):
    child = etree.SubElement(parent, tag)
    child.text = text
    return child


def values(parent, rows, tag="V", label=False):
    phys = add(parent, "SW-VALUES-PHYS")
    for row in rows:
        if isinstance(row, (list, tuple)):
            group = add(phys, "VG")
            if label:
                add(group, "LABEL", "row")
            for v in row:
                add(group, tag, str(v))
        else:
            add(phys, tag, str(row))


def instance(tree, name, category, rows=None, unit=None, size=None, axes=(), tag="V", index=None, label=False):
    i = add(tree, "SW-INSTANCE")
    if index is None:
        add(i, "SHORT-NAME", name)
    else:
        add(i, "SW-ARRAY-INDEX", str(index))
    add(i, "LONG-NAME", f"about {name}")
    add(i, "CATEGORY", category)
    if rows is not None:
        cont = add(i, "SW-VALUE-CONT")
        if unit is not None:
            add(cont, "UNIT-DISPLAY-NAME", unit)
        if size is not None:
            n = add(cont, "SW-ARRAYSIZE")
            for v in size:
                add(n, "V", str(v))
        values(cont, rows, tag, label)
    if axes:
        conts = add(i, "SW-AXIS-CONTS")
        for kind, unit, points in axes:
            cont = add(conts, "SW-AXIS-CONT")
            if kind is not None:
                add(cont, "CATEGORY", kind)
            if unit is not None:
                add(cont, "UNIT-DISPLAY-NAME", unit)
            if isinstance(points, str):
                add(cont, "SW-INSTANCE-REF", points)
            else:
                values(cont, points)
    return i


def root():
    top = etree.Element("MSRSW")
    add(top, "SHORT-NAME", "FILE")
    add(top, "CATEGORY", "CDF20")
    system = add(add(top, "SW-SYSTEMS"), "SW-SYSTEM")
    add(system, "SHORT-NAME", "ECU")
    tree = add(add(system, "SW-INSTANCE-SPEC"), "SW-INSTANCE-TREE")
    add(tree, "SHORT-NAME", "TREE")
    add(tree, "CATEGORY", "NO_VCD")
    return top, tree


def common(tree, label=False):
    instance(tree, "AxN", "COM_AXIS", [800, 1600, 3200], "1/min", [3])
    instance(tree, "AxL", "COM_AXIS", [0.2, 0.9], None, [2])
    instance(tree, "Scalar", "VALUE", [-1.5e-3], "\u00b0KW")
    instance(tree, "Block", "VAL_BLK", [1, 2, 3, 4], "-", [4])
    instance(tree, "Curve", "CURVE", [5, 6, 7], "Nm", axes=[("STD_AXIS", "\u00b0C", [-40, 20, 90])])
    instance(tree, "Map", "MAP", [(1, 2, 3), (4, 5, 6)], "mg", axes=[("COM_AXIS", None, "AxN"), ("COM_AXIS", "g/s", "AxL")], label=label)


def every_category(tree):
    instance(tree, "Fixed", "CURVE", [1, 2], "", axes=[("FIX_AXIS", "-", [0, 1])])
    instance(tree, "NoCategory", "CURVE", [1, 2, 3], "", axes=[(None, None, "AxN")])
    instance(tree, "Depends", "DEPENDENT_VALUE", [4], "-")
    instance(tree, "Text", "ASCII", ["v1.2"], tag="VT")
    instance(tree, "Flag", "BOOLEAN", ["true"], tag="VT")
    instance(tree, "State", "VALUE", ["on"], tag="VT")
    instance(tree, "States", "CURVE", ["low", "high", "low"], tag="VT", axes=[("COM_AXIS", None, "AxN")])
    instance(tree, "Rescale", "RES_AXIS", [0, 1, 2], "-", [3])
    instance(tree, "OnRescale", "CURVE", [1, 2, 3], "", axes=[("RES_AXIS", None, "Rescale")])
    structure = instance(tree, "Struct", "STRUCTURE")
    instance(structure, "gain", "VALUE", [2.5], "-")
    inner = instance(structure, "inner", "STRUCTURE")
    instance(inner, "list", "VAL_BLK", [7, 8], "-", [2])
    array = instance(tree, "Array", "VALUE_ARRAY")
    instance(array, None, "VALUE", [10], "-", index=0)
    instance(array, None, "VALUE", [11], "-", index=1)
    variants = add(instance(tree, "Variants", "VALUE"), "SW-INSTANCE-PROPS-VARIANTS")
    variant = add(variants, "SW-INSTANCE-PROPS-VARIANT")
    values(add(variant, "SW-VALUE-CONT"), [1])
    history = instance(tree, "History", "VALUE", [3], "-")
    entry = add(add(history, "SW-CS-HISTORY"), "CS-ENTRY")
    for tag, text in [("STATE", "changed"), ("DATE", "2024-03-05T14:07:30"), ("CSUS", "me")]:
        add(entry, tag, text)


parser = etree.XMLParser()
parser.resolvers.add(Stub())
xsd = etree.XMLSchema(etree.parse(os.path.join(schema, "cdf_v2.0.0.sl.xsd"), parser))
dtd = etree.DTD(open(os.path.join(schema, "cdf_v2.0.0.sl.dtd")))


def save(name, top, encoding, by_schema=True):
    if by_schema:
        assert xsd.validate(top), (name, xsd.error_log)
        assert dtd.validate(top), (name, dtd.error_log)
    etree.ElementTree(top).write(os.path.join(folder, name), encoding=encoding, xml_declaration=True, pretty_print=True)


top, tree = root()
common(tree)
every_category(tree)
save("latin.cdfx", top, "ISO-8859-1")
save("utf16.cdfx", top, "UTF-16")
top, tree = root()
common(tree, label=True)
save("labelled.cdfx", top, "UTF-8")
# A default namespace, which the schema does not have.
for element in top.iter():
    element.tag = "{http://www.example.org/cdf}" + element.tag
etree.cleanup_namespaces(top, top_nsmap={None: "http://www.example.org/cdf"})
save("namespace.cdfx", top, "UTF-8", by_schema=False)
