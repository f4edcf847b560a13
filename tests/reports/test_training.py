"""Training in a report: what methods say of it, whatever they are."""

from ndf_mi.reports import training


def test_notes_are_of_methods_that_have_something_to_say(results):
    (note,) = training.notes(results)
    for text in ("Mesh, to convergence", "12 s", "100 steps", "Learning rate 0.1."):
        assert text in note
    assert "loss stopped falling" in note
    results.methods[1].metadata.update(budget=12.0)
    assert "loss stopped falling" not in training.notes(results)[0]
    results.methods[2].metadata["note"] = "Pictures from elsewhere."
    assert training.notes(results)[1] == "Gaussian <surprise>: Pictures from elsewhere."


def test_a_method_that_converged_early_stands_for_equal_time(results, add_method):
    (note,) = training.equal_time_notes(results)
    assert "Mesh, to convergence" in note and "1 min 01 s" in note
    results.methods.append(add_method("mesh-equal-time", "Mesh, equal time", 0.02))
    assert not training.equal_time_notes(results)


def test_times_of_all_methods(results):
    results.methods[0].metadata |= {"peak_memory": 1_500_000_000, "size_on_disk": 12_300_000}
    rows = {row.label: [cell.text for cell in row.cells] for row in training.times(results).rows}
    assert rows == {
        "NDF": ["1 min 01 s", "1,000", "1.5 GB", "12 MB", "0.25 s"],
        "Mesh, to convergence": ["12 s", "100", "–", "–", "0.25 s"],
        "Gaussian <surprise>": ["–", "–", "–", "–", "0.25 s"],
    }


def test_curves_of_those_that_kept_one(results):
    alt = training.curves(results).alt
    # A mean squared error of 0.1 is 10 dB.
    assert (
        "NDF: from 10 at 0.1" in alt
        and "Mesh, to convergence: from 10 at 0.1" in alt
        and "surprise" not in alt
    )
    for method in results.methods:
        method.metadata.pop("history", None)
    assert training.curves(results) is None


def test_held_back_views_have_a_curve_and_the_kept_step_is_ringed(results):
    assert training.curves(results).title == "PSNR of the training loss"
    results.methods[0].metadata |= {
        "held_back": [[50, 1.0, 20.0], [100, 2.0, 23.5], [150, 3.0, 22.0]], "kept_step": 100}
    chart = training.curves(results)
    assert "NDF, held-back views: from 20 at 1 to 22 at 3" in chart.alt
    assert "NDF, kept: step 100: 23.5 at 2." in chart.alt
    (ring,) = [key for key in chart.legend if key.shape == "ring"]
    (line,) = [key for key in chart.legend if key.label == "NDF, held-back views"]
    assert ring.colour == line.colour and "held-back" in chart.title


def test_everything_that_a_method_reports_is_printed(results):
    facts = [training.metadata_fact(method) for method in results.methods]
    assert facts[1].lines == (
        "seconds 12.5, steps 100, converged True",
        "training loss by learning rate: 0.1 0.002",
    )
    assert facts[2].lines == ("holes: count 3",)
    results.methods[2].metadata = {}
    assert training.metadata_fact(results.methods[2]).lines == ("–",)
