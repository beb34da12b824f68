"""Numbers as one would typeset them."""

import math

MINUS, DASH, _TIMES = "\u2212", "\u2014", "\u00d7"
_POWERS = str.maketrans("0123456789-", "\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079\u207b")


def number(value: float, digits: int = 4) -> str:
    """A number with so many digits, as one would typeset it; a dash for none."""
    if not math.isfinite(value):
        return DASH
    mantissa, _, power = f"{value:.{digits}g}".partition("e")
    return mantissa.replace("-", MINUS) + (f"{_TIMES}10{str(int(power)).translate(_POWERS)}" if power else "")


def number_with_error(value: float, std: float) -> tuple[str, str]:
    """A number and its standard deviation, with the digits that this leaves."""
    if not (math.isfinite(std) and std > 0 and math.isfinite(value)):
        return number(value), number(std, 2)
    places = 1 - math.floor(math.log10(std))
    if places > 6 or places < 0 or abs(value) >= 1e6:
        return number(value, 6), number(std, 2)
    # Adding zero makes a negative zero positive.
    return f"{round(value, places) + 0.0:.{places}f}".replace("-", MINUS), f"{std:.{places}f}"


def percent(value: float) -> str:
    """A share in percent, with one decimal where that says something."""
    if not math.isfinite(value):
        return DASH
    shown = 100 * value
    return "over 1000\u00a0%" if shown > 1000 else f"{number(shown, 2) if 0 < shown < 0.1 else format(shown, '.1f')}\u00a0%"
