"""The folder of a service's data. It imports no Ray, so that `adr serve` can refuse one at once."""

import logging
import stat
import tempfile
from pathlib import Path

from adr_service.errors import InvalidInput
from db.staging import PREFIX

log = logging.getLogger(__name__)
# names, or how they begin, by which a data folder is known
_OWN_FILES = ("adr.sqlite", "ray", "service.log", "compile_cache", "films", PREFIX)


def prepare_folder(data_dir: Path) -> None:
    """Make a folder for results and secrets that no other user of the machine can read.

    Raises InvalidInput if others can read it and it has files, none of them the service's.
    """
    try:
        data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
        mode = stat.S_IMODE(data_dir.stat().st_mode)
        if mode & 0o077:
            names = {path.name for path in data_dir.iterdir()}
            if names and not any(name.startswith(_OWN_FILES) for name in names):
                raise InvalidInput(
                    f"{data_dir} is open to others (mode {mode:o}) and has other files than the "
                    "service's: give it a folder of its own (ADR_DATA_DIR, --data-dir), or close "
                    f"this one (chmod 700 {data_dir})"
                )
            data_dir.chmod(0o700)
            log.warning("%s was open to others (mode %o); now it is yours alone", data_dir, mode)
        with tempfile.TemporaryFile(dir=data_dir):
            pass  # it can be written
    except OSError as error:
        raise InvalidInput(f"there can be no data in {data_dir}: {error}") from error
