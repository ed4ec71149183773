"""ASAM's DTD and XSD by lxml, then values against the JSON of the same package."""
import json
import os
import re
import sys

from lxml import etree

path, wanted, schema = sys.argv[1:4]
tree = etree.parse(path)
dtd = etree.DTD(open(os.path.join(schema, "cdf_v2.0.0.sl.dtd")))
assert dtd.validate(tree), dtd.error_log
# The xml.xsd that travels with the schema is broken; these six lines say what is used of it.
stub = """<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema" targetNamespace="http://www.w3.org/XML/1998/namespace">
<xs:attribute name="lang" type="xs:language"/><xs:attribute name="space" type="xs:NCName"/>
<xs:attribute name="base" type="xs:anyURI"/><xs:attribute name="id" type="xs:ID"/>
<xs:attributeGroup name="specialAttrs"><xs:attribute ref="xml:base"/><xs:attribute ref="xml:lang"/>
<xs:attribute ref="xml:space"/><xs:attribute ref="xml:id"/></xs:attributeGroup></xs:schema>"""


class Stub(etree.Resolver):
    def resolve(self, url, public_id, context):
        if url.endswith("xml.xsd"):
            return self.resolve_string(stub, context)
        return None


parser = etree.XMLParser()
parser.resolvers.add(Stub())
xsd = etree.XMLSchema(etree.parse(os.path.join(schema, "cdf_v2.0.0.sl.xsd"), parser))
assert xsd.validate(tree), xsd.error_log
instances = {i.findtext("SHORT-NAME"): i for i in tree.iter("SW-INSTANCE")}
want = {c["name"]: c for c in json.load(open(wanted))["package"]["characteristics"]}
for name, c in want.items():
    i = instances[name]
    values = [float(v.text) for v in i.find("SW-VALUE-CONT/SW-VALUES-PHYS").iter("V")]
    assert values == c["values"], name
    assert i.findtext("SW-VALUE-CONT/UNIT-DISPLAY-NAME") == c["unit"]
    assert i.findtext("LONG-NAME") == c["description"]
    conts = i.findall("SW-AXIS-CONTS/SW-AXIS-CONT")
    assert len(conts) == len(c["axes"])
    for cont, axis in zip(conts, c["axes"]):
        ref = cont.findtext("SW-INSTANCE-REF")
        source = instances[ref].find("SW-VALUE-CONT/SW-VALUES-PHYS") if ref else cont.find("SW-VALUES-PHYS")
        assert bool(ref) == axis["shared"] and [float(v.text) for v in source] == axis["points"], (name, ref)
    groups = i.findall("SW-VALUE-CONT/SW-VALUES-PHYS/VG")
    if len(c["axes"]) == 2:
        assert [len(g) for g in groups] == [len(c["axes"][0]["points"])] * len(c["axes"][1]["points"])
print(f"CDFX: DTD, XSD and {len(want)} characteristics agree")
