"""Groups of points that may be compared, and their Pareto fronts."""

from ndf_mi.reports.fronts import comparable, groups


def test_groups_are_of_points_that_may_be_compared(trade):
    found = {group.title: group for group in groups(trade)}
    assert list(found) == ["Against the truth", "Against convergence", "Other fields", "Path tracing"]
    assert [row.key for row in found["Against the truth"].rows] == ["usual", "8", "16", "slow"]
    assert [row.key for row in found["Other fields"].rows] == ["own", "wide"]
    assert [row.key for row in found["Path tracing"].rows] == ["path"], "without figures against the truth"
    assert (
        found["Against the truth"].reference == ("converged", 31.0)
        and found["Against convergence"].reference is None
    )


def test_a_front_its_knee_and_its_summary(trade):
    truth, convergence, fields, paths = groups(trade)
    assert [truth.rows[i].key for i in truth.front] == ["8", "16", "usual"] and truth.rows[
        truth.knee
    ].key == "16"
    assert truth.values[truth.front[0]] == 20.0 and convergence.values[convergence.front[0]] == 30.0
    assert (
        "8 samples (0.20 s, 20.00 dB)" in truth.summary
        and "knee is 16 samples (0.40 s, 28.00 dB)" in truth.summary
    )
    assert "no knee" in fields.summary and "path samples" in paths.summary
    assert "knee" in truth.chart.alt and "converged, 31.00" in truth.chart.alt


def test_rows_without_times_or_finite_figures_are_on_no_front(trade):
    trade.row("8").seconds = []
    trade.row("16").figures[0].truth["box_psnr"] = float("inf")
    assert [row.key for row in groups(trade)[0].rows] == ["usual", "slow"]


def test_rows_of_another_machine_are_not_compared(trade):
    assert [row.key for row in trade.rows if not comparable(trade, row)] == ["elsewhere"]
    trade.about["sessions"]["before"]["machine"] = {"Cores": "2"}
    assert "elsewhere" in [row.key for row in groups(trade)[0].rows]
