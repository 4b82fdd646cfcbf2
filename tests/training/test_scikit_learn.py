"""Which of scikit-learn's checks of an estimator `Narx` passes, and why others cannot apply."""

from sklearn.utils.estimator_checks import parametrize_with_checks

from narxcal import Narx

_RECORDS = "fit takes records of a dynamic system: rows of one array X are neither records nor free"
_PAST = "a prediction is from past outputs: predict takes u and y, not X alone"
_ORDER = "samples are in the order of time"

CANNOT_APPLY = dict.fromkeys(
    (
        "check_fit_score_takes_y", "check_estimators_overwrite_params",
        "check_dont_overwrite_parameters", "check_estimators_fit_returns_self",
        "check_readonly_memmap_input", "check_n_features_in_after_fitting",
        "check_positive_only_tag_during_fit", "check_estimators_dtypes", "check_complex_data",
        "check_dtype_object", "check_estimators_empty_data_messages", "check_pipeline_consistency",
        "check_estimators_nan_inf", "check_estimator_sparse_tag", "check_estimator_sparse_array",
        "check_estimator_sparse_matrix", "check_estimators_pickle",
        "check_f_contiguous_array_estimator", "check_regressors_train",
        "check_regressor_data_not_an_array", "check_regressors_no_decision_function",
        "check_supervised_y_2d", "check_supervised_y_no_nan", "check_regressors_int",
        "check_fit2d_1sample", "check_fit2d_1feature", "check_dict_unchanged",
        "check_fit_idempotent", "check_fit_check_is_fitted", "check_n_features_in", "check_fit1d",
        "check_fit2d_predict1d", "check_requires_y_none",
    ),
    _RECORDS,
) | {
    "check_estimators_unfitted": _PAST,
    "check_methods_sample_order_invariance": _ORDER,
    "check_methods_subset_invariance": _ORDER,
}  # fmt: skip


@parametrize_with_checks([Narx()], expected_failed_checks=lambda _: CANNOT_APPLY, xfail_strict=True)
def test_checks_of_scikit_learn(estimator, check):
    check(estimator)
