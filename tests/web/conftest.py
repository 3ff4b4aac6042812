from collections.abc import Iterator

import pytest
from selenium import webdriver

from tests import peers
from tests.storage.conftest import memory

__all__ = ["memory"]


@pytest.fixture(scope="module")
def driver() -> Iterator[webdriver.Chrome]:
    """A real browser that logs what it asks and what it finds wrong."""
    options = webdriver.ChromeOptions()
    options.binary_location = peers.program("chromium", "chromium")
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu",
                     "--disable-background-networking", "--disable-component-update",
                     "--no-first-run"):  # fmt: skip
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
    made = webdriver.Chrome(
        options, webdriver.ChromeService(peers.program("chromedriver", "chromium-driver"))
    )
    yield made
    made.quit()
