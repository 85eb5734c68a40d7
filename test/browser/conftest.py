# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""One browser for all tests of a process."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))

from browser import Browser, find_browser


@pytest.fixture(scope="session")
def browser(tmp_path_factory) -> Iterator[Browser]:
    executable = find_browser()
    if executable is None:
        pytest.skip("no Chromium here: apt-get install chromium")
    with Browser(executable, tmp_path_factory.mktemp("browser")) as browser:
        yield browser


@pytest.fixture
def page(browser) -> Iterator[Browser]:
    """Return the browser with an empty page.

    It is empty again afterwards: without a graphics card an open page takes a processor.
    """
    browser.reset()
    yield browser
    browser.reset()
