import pytest

from ostiform.errors import InputError
from ostiform.study import parsed_settings, read_settings
from ostiform.surface import Seam

MINIMAL = """
schema = 1
[parts.LA]
ostia = ["mitral", "RSPV"]
[shapes]
pattern = "{subject}.vtp"
"""

LEFT_HEART = """
schema = 1
units = "mm"              # mm | cm | m
frame = "LPS"             # LPS | RAS
pole = "LV.mitral"
[parts.LV]
ostia = ["mitral", "aortic"]
[parts.LA]
ostia = ["mitral", "RSPV", "RIPV", "LSPV", "LIPV"]
[[seams]]
first = "LV.mitral"
second = "LA.mitral"
[shapes]
pattern = "{subject}_{phase}_{part}.vtp"   # or sheet = "shapes.csv"
on_error = "skip"         # skip | stop
open = {array = "ModelFaceID", aortic = 3, "LA.RSPV" = 2}
[shapes.times]
ED = 0.0
ES = 0.35
[ostia.points]            # rough positions, for the population or per shape
"LA.RSPV" = [0.0, 0.0, 0.0]
[ostia.shapes."s1/ED"]
"LA.RSPV" = [1.0, 0.0, 0.0]
[alignment]
mode = "rigid"
per = "subject"
[welding]
tolerance_mm = 0.5
[domain.circles."LA.RSPV"]
center = [0.1, 0.2, 0.9]
radius_deg = 5
phase_deg = 30
frame = "part"
[embedding]
method = "harmonic-barrier"
[template]
points = 1200
[correspondence]
optimiser = "conjugate-gradient"
levels = 3
noise_mm = 0.3
seed = 7
[evaluation]
modes = 5
specificity_samples = 100
truth = "truth.json"
"""


def changed(old, new, text=MINIMAL):
    assert old in text
    return text.replace(old, new)


def test_a_minimal_study_takes_the_defaults():
    settings = parsed_settings(MINIMAL)
    assert (settings.units, settings.frame, settings.pole, settings.seed) == ("mm", "LPS", None, 0)
    assert settings.part_names == ("LA",)
    assert settings.ostium_names == ("LA.mitral", "LA.RSPV")
    assert settings.shapes.on_error == "skip"
    assert settings.embedding.method == "barrier"
    assert settings.template.points == 2500
    assert settings.correspondence.model_dump() == {
        "optimiser": "majorise",
        "levels": 4,
        "noise_mm": None,
        "coherence": 1e6,
        "batch": None,
        "seed": 0,
    }
    assert settings.alignment.model_dump() == {"mode": "rigid", "per": None, "frame": "found"}
    assert settings.evaluation.model_dump() == {
        "modes": 10,
        "folds": None,
        "specificity_samples": 1000,
        "truth": None,
        "collapse": "stop",
    }


def test_every_key_of_the_design_is_read():
    settings = parsed_settings(LEFT_HEART)
    assert settings.seam_pairs == (Seam("LV.mitral", "LA.mitral"),)
    assert settings.caps == {"LV.aortic": 3.0, "LA.RSPV": 2.0}
    assert settings.ostia.shapes["s1/ED"]["LA.RSPV"] == (1.0, 0.0, 0.0)
    circle = settings.domain.circles["LA.RSPV"]
    assert (circle.radius_deg, circle.phase_deg, circle.frame) == (5.0, 30.0, "part")
    assert settings.evaluation.truth == "truth.json"
    assert settings.shapes.times == {"ED": 0.0, "ES": 0.35}


def test_four_chambers_and_a_closed_part_are_a_study():
    text = """
schema = 1
[parts.LV]
ostia = ["mitral", "aortic"]
[parts.LA]
ostia = ["mitral", "RSPV"]
[parts.RV]
ostia = ["tricuspid", "pulmonary"]
[parts.RA]
ostia = ["tricuspid", "SVC", "IVC"]
[parts.myocardium]
[[seams]]
first = "LV.mitral"
second = "LA.mitral"
[[seams]]
first = "RV.tricuspid"
second = "RA.tricuspid"
[shapes]
sheet = "shapes.csv"
"""
    settings = parsed_settings(text)
    assert len(settings.parts) == 5
    assert settings.parts["myocardium"].ostia == ()


def test_a_seam_of_a_part_with_itself_can_be_written():
    text = MINIMAL + '[[seams]]\nfirst = "LA.mitral"\nsecond = "LA.RSPV"\n'
    assert parsed_settings(text).seam_pairs == (Seam("LA.mitral", "LA.RSPV"),)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (changed("schema = 1", ""), "schema: expected this key, found none"),
        (changed("schema = 1", "schema = 2"), "schema: expected 1, found 2"),
        (
            changed("schema = 1", "schema = 1\nunits = 'inch'"),
            "units: expected 'mm', 'cm', 'm' or 'um'",
        ),
        (changed("schema = 1", "schema = 1\ncolour = 3"), "colour: unknown key"),
        (changed("schema = 1", "schema = 1\npole = 'LA.x'"), 'pole: expected "PART.OSTIUM"'),
        (changed("[parts.LA]", '[parts."L.A"]'), r'parts."L.A" \(its name\): expected a name'),
        (changed('"RSPV"]', '"RS.PV"]'), r"parts.LA.ostia\[1\]: expected a name without"),
        (changed('"RSPV"]', '"mitral"]'), "parts.LA.ostia: expected different names, found mitral"),
        (changed('pattern = "{subject}.vtp"', ""), "pattern and sheet, found none"),
        (changed("[shapes]", "[shapes]\nsheet='a.csv'"), "pattern and sheet, found both"),
        (changed("[shapes]", "[shapes]\non_error='go'"), "shapes.on_error: expected 'skip' or"),
        (changed("[shapes]", "[shapes]\nopen={mitral=3}"), "shapes.open.array: expected the name"),
        (
            changed("[shapes]", "[shapes]\nopen={array='a', aortic=3}"),
            "shapes.open.aortic: expected an ostium",
        ),
        (
            changed("[shapes]", "[shapes]\nopen={array='a', mitral='x'}"),
            'shapes.open.mitral: expected a number, found "x"',
        ),
        (MINIMAL + "[shapes.times]\nED = 1.0", "shapes.times.ED: expected less than 1, found 1.0"),
        (MINIMAL + "[template]\npoints = 2.5", "template.points: expected a valid integer"),
        (MINIMAL + "[template]\npoints = 3", "template.points: expected greater than or equal"),
        (
            MINIMAL + '[ostia.points]\n"LA.RSPV" = [0, 0]',
            r'ostia.points."LA.RSPV"\[2\]: expected this key, found none',
        ),
        (
            MINIMAL + '[ostia.points]\n"LA.RSPV" = [0, 0, nan]',
            r'ostia.points."LA.RSPV"\[2\]: expected a finite number, found nan',
        ),
        (
            MINIMAL + '[ostia.points]\n"LA.RSVP" = [0, 0, 0]',
            r'ostia.points."LA.RSVP": expected "PART.OSTIUM" .* found "LA.RSVP"',
        ),
        (
            MINIMAL + '[ostia.shapes."1/0"]\n"RSPV" = [0, 0, 0]',
            r'ostia.shapes."1/0".RSPV: expected "PART.OSTIUM"',
        ),
        (
            MINIMAL + '[domain.circles."LA.x"]\ncenter=[0,0,1]\nradius_deg=4',
            r'domain.circles."LA.x": expected "PART.OSTIUM"',
        ),
        (
            MINIMAL + '[domain.circles."LA.RSPV"]\ncenter=[0,0,1]\nradius_deg=0',
            'domain.circles."LA.RSPV".radius_deg: expected greater than 0, found 0',
        ),
        (
            changed('first = "LV.mitral"', 'first = "LV.mitrl"', LEFT_HEART),
            r'seams\[0\].first: expected "PART.OSTIUM" with a part named in \[parts\] and one of '
            'its ostia, found "LV.mitrl"',
        ),
        (
            LEFT_HEART + '[[seams]]\nfirst = "LV.aortic"\nsecond = "LA.mitral"\n',
            r"seams\[1\].second: expected an ostium of no other seam, .* of seams\[0\].second",
        ),
        ("schema = \n", r"expected TOML, found a mistake: .*line 1"),
    ],
)
def test_a_mistake_is_named_with_its_key(text, message):
    with pytest.raises(InputError, match=f"study.toml: .*{message}"):
        parsed_settings(text)


def test_all_mistakes_are_listed_at_once():
    text = changed("schema = 1", "schema = 3\nunits = 'inch'")
    with pytest.raises(InputError, match=r"schema: .*; units: "):
        parsed_settings(text)


def test_files_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(InputError, match="found none: check the path"):
        read_settings(tmp_path / "study.toml")
    with pytest.raises(InputError, match="cannot be read"):
        read_settings(tmp_path)
    latin = tmp_path / "study.toml"
    latin.write_bytes("schema = 1 # Größe".encode("latin-1"))
    with pytest.raises(InputError, match="UTF-8"):
        read_settings(latin)


def test_settings_cannot_be_changed():
    settings = parsed_settings(MINIMAL)
    with pytest.raises(Exception, match="frozen"):
        settings.units = "cm"


def test_one_fold_is_no_cross_validation():
    with pytest.raises(InputError, match=r"evaluation.folds: expected 0 for none or at least 2"):
        parsed_settings(MINIMAL + "[evaluation]\nfolds = 1\n")


def test_a_study_that_begins_with_a_byte_order_mark_is_read(tmp_path):
    text = '[parts.LV]\nostia = ["mitral"]\n[shapes]\npattern = "{subject}.vtp"\n'
    path = tmp_path / "study.toml"
    path.write_bytes(b"\xef\xbb\xbf" + f"schema = 1\n{text}".encode())
    assert list(read_settings(path).parts) == ["LV"]
