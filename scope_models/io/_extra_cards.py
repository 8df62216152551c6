"""Cards that the caller adds to the headers of a target pixel file."""

import warnings

import numpy as np

__all__ = ["with_extra_cards"]

_PROTECTED = ("SIMPLE", "BITPIX", "EXTEND", "NEXTEND", "EXTNAME", "EXTVER", "CHECKSUM", "DATASUM")


def with_extra_cards(extra_cards, primary, *others):
    """Fill cards without a value, or add cards to the primary header.

    Parameters
    ----------
    extra_cards : mapping
        Keyword to value, or to value and comment.
    primary, *others : list of tuple
        Cards of each header.

    Returns
    -------
    list of list of tuple
        The cards of each header.

    Raises
    ------
    ValueError
        If a keyword or value cannot be a card, or the card has a value already.
    """
    headers = [list(primary), *(list(cards) for cards in others)]
    for keyword, given in extra_cards.items():
        card = _checked_card(keyword, given)
        places = [
            (cards, index)
            for cards in headers
            for index, (present, *_) in enumerate(cards)
            if present == card[0]
        ]
        if card[0] in _PROTECTED or any(cards[i][1] is not None for cards, i in places):
            raise ValueError(f"`extra_cards` must not replace {keyword}, which the file sets")
        for cards, index in places:
            cards[index] = (card[0], card[1], card[2] or cards[index][2])
        if not places:
            headers[0].append(card)
    return headers


def _checked_card(keyword, given):
    """Return keyword, value and comment of a card that FITS allows."""
    from astropy.io import fits

    value, comment = given if isinstance(given, tuple) and len(given) == 2 else (given, "")
    if not isinstance(keyword, str) or not 1 <= len(keyword) <= 8:
        raise ValueError(f"`extra_cards` must have keywords of 1 to 8 characters, got {keyword!r}")
    value = value.item() if isinstance(value, np.generic) else value
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            card = fits.Card(keyword.upper(), value, comment)
            card.verify("exception")
            str(card)
    except (ValueError, TypeError, fits.VerifyError, fits.verify.VerifyWarning) as error:
        raise ValueError(f"`extra_cards` cannot hold {keyword}: {error}") from error
    if isinstance(value, str) and "EVEREST" in value.upper() and keyword.upper() == "COMMENT":
        raise ValueError("`extra_cards` must have no COMMENT with EVEREST: readers misread it")
    return card.keyword, card.value, card.comment
