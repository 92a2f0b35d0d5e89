"""What a person reads whose words are refused."""

from handctl.cli.main import main


def refused(capsys, *words):
    """The one line that a command ends with."""
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("handctl: ")
    assert err.count("\n") == 1, err
    return err
