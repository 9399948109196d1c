"""Tables of the thesis, as printed, that only ``tcdyn verify`` needs.

Used by the ``..._rows`` modules. Numbers are as printed and must not be corrected; a misprint is a
verdict of its row. Numbers that the simulator needs, too, are in ``tcdyn/simulate/programme.py``.
"""

from __future__ import annotations

# Pairs of junctions in the same group, and in different groups.
PAIRS_SAME = "same"
PAIRS_OTHER = "other"
# Tables 6.2 to 6.4: the two groups of junctions, and the result of each pair: l(ogical), w(eak),
# i(llogical), n(ot applicable).
COMPARED = (
    ("aef|bcd", "ae l af l ab i ac i ad i ef l eb i ec i ed w fb l fc n fd w bc n bd l cd l"),
    ("acd|bef", "ac l ad l ab i ae i af i cd l cb w ce w cf i db w de n df w be n bf l ef l"),
    ("acd|bef", "ac l ad l ab l ae i af l cd l cb n ce w cf i db l de n df w be n bf l ef l"),
)
# Table 6.5: number of pairs of each result.
TABLE_6_5 = {
    PAIRS_OTHER: {"l": 4, "w": 8, "i": 11, "n": 4},
    PAIRS_SAME: {"l": 15, "w": 0, "i": 0, "n": 3},
}

# tests of Clarke (2009), A1 to D4 in the order of the programme: table 7.1, h of fast and slow disk
# [W/m2K]
CLARKE_H = (
    (921, 352),
    (830, 317),
    (860, 328),
    (661, 252),
    (950, 363),
    (946, 361),
    (927, 354),
    (746, 285),
    (1287, 491),
    (1085, 414),
    (843, 322),
    (873, 333),
    (1251, 478),
    (1110, 424),
    (929, 355),
    (886, 338),
)
# table 7.2: a of fast and slow disk [degC], friction [N]
CLARKE_STEADY = (
    (79.4, 65.9, 10.5),
    (101.6, 77.3, 18.5),
    (110.3, 81.3, 23.4),
    (125.3, 89.9, 26.5),
    (86.2, 70.8, 8.5),
    (110.1, 82.6, 17.3),
    (121.9, 88.4, 21.5),
    (136.4, 96.9, 24.1),
    (89.9, 74.2, 8.9),
    (115.6, 87.1, 16.0),
    (130.3, 94.1, 19.4),
    (146.9, 103.7, 25.0),
    (90.9, 76.2, 7.8),
    (118.2, 91.3, 14.9),
    (139.0, 101.6, 19.1),
    (157.7, 112.8, 23.4),
)
# table 7.3: difference of the surfaces' greatest temperatures times sliding speed [K m/s], beta of
# models F and C
TABLE_7_3 = (
    (156.6, 0.69, 0.48),
    (222.0, 0.68, 0.48),
    (277.4, 0.68, 0.47),
    (329.6, 0.68, 0.47),
    (204.8, 0.68, 0.48),
    (325.4, 0.68, 0.47),
    (404.4, 0.68, 0.47),
    (452.0, 0.68, 0.46),
    (251.3, 0.68, 0.47),
    (296.5, 0.68, 0.47),
    (502.5, 0.68, 0.46),
    (578.8, 0.67, 0.46),
    (249.6, 0.68, 0.47),
    (458.2, 0.68, 0.46),
    (574.4, 0.68, 0.46),
    (697.1, 0.67, 0.45),
)
# figures 4.13 to 4.16: share and h [W/m2K] at both ends of the lines of least error, and the rise
# of the temperature
# near the contact from the first end to the second [K]
LINE_ENDS = {
    "fast": ((0.37, 100.0), (0.83, 1200.0), 6.0),
    "slow": ((0.20, 100.0), (0.48, 1200.0), 4.0),
}
