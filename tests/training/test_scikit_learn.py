"""Which of scikit-learn's checks of an estimator `Narx` passes, and why others cannot apply."""

import pytest
from sklearn.utils.estimator_checks import parametrize_with_checks

from narxcal import Narx

_ORDER = "rows are in the order of time, and each depends on those before it"
_WORDS = "refused by a DataError that says what was expected and found, not in scikit-learn's words"
CANNOT_APPLY = {
    "check_methods_sample_order_invariance": _ORDER,
    "check_methods_subset_invariance": _ORDER,
    "check_fit1d": "one dimension is one input over time",
    "check_supervised_y_2d": "a column is an output as well: several are fitted together",
    "check_regressor_data_not_an_array": "its array refuses the search for complex numbers",
} | dict.fromkeys(
    (
        "check_n_features_in_after_fitting", "check_complex_data", "check_dtype_object",
        "check_estimators_empty_data_messages", "check_estimators_nan_inf",
        "check_estimator_sparse_tag", "check_estimator_sparse_array",
        "check_estimator_sparse_matrix", "check_regressors_train", "check_supervised_y_no_nan",
        "check_fit2d_1sample", "check_fit2d_predict1d", "check_requires_y_none",
    ),
    _WORDS,
)  # fmt: skip


@pytest.mark.slow
@parametrize_with_checks(
    [Narx(time_limit_s=0.02)], expected_failed_checks=lambda _: CANNOT_APPLY, xfail_strict=True
)
def test_checks_of_scikit_learn(estimator, check):
    check(estimator)
