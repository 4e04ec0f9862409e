from __future__ import annotations

import numpy as np
import pytest

from skincal.model import Contacts, contact_rotations

UP = np.array([[0.0, 0.0, 1.0]])


def _random_normals(count: int) -> np.ndarray:
    normals = np.random.default_rng(1).normal(size=(count, 3))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_default_rotations_are_rotations_with_z_along_the_normal():
    normals = np.concatenate([_random_normals(50), np.eye(3), -np.eye(3)])
    rotations = contact_rotations(normals)
    np.testing.assert_allclose(
        np.swapaxes(rotations, 1, 2) @ rotations, np.tile(np.eye(3), (56, 1, 1)), atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    np.testing.assert_array_equal(rotations[:, :, 2], normals)


def test_default_y_follows_the_finger_and_x_lies_across():
    rotation = contact_rotations([[np.sin(0.4), 0.0, np.cos(0.4)]])[0]
    np.testing.assert_allclose(rotation[:, 1], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(rotation[:, 0], [np.cos(0.4), 0, -np.sin(0.4)], atol=1e-15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_at_the_tip_x_follows_the_finger(sign):
    np.testing.assert_allclose(contact_rotations([[0.0, sign, 0.0]])[0][:, 0], [1, 0, 0], atol=1e-15)


def test_rows_with_nan_are_kept_and_known_as_such():
    contacts = Contacts(
        [[0, 0, 0.01], [np.nan] * 3, [0, 0, 0.01], [0, 0, 0.01]],
        [[0, 0, 1], [0, 0, 1], [np.nan] * 3, [0, 0, 1]],
        [1.0, 1.0, 1.0, np.inf],
    )
    np.testing.assert_array_equal(contacts.known, [True, False, False, False])


def test_some_of_the_contacts():
    contacts = Contacts(np.zeros((3, 3)), _random_normals(3), [1.0, 2.0, 3.0], origins_m=np.ones((3, 3)))
    some = contacts[1:]
    assert len(some) == 2
    np.testing.assert_array_equal(some.force_n, [2.0, 3.0])
    np.testing.assert_allclose(some.normals, contacts.normals[1:], rtol=1e-15)
    assert some.rotations is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"normals": 2 * UP}, "unit vectors; got length 2 in row 0"),
        ({"normals": np.zeros((2, 3))}, "unit vectors"),
        ({"points_m": np.zeros((1, 2))}, r"contact points_m: expected shape \('any', 3\); got \(1, 2\)"),
        ({"force_n": np.ones(2)}, r"contact force_n: expected shape \(1\,\); got \(2\,\)"),
        ({"rotations": -np.eye(3)[None]}, "right-handed rotation matrices; got none in row 0"),
        ({"rotations": np.ones((1, 3, 3))}, "right-handed"),
        ({"origins_m": np.zeros(3)}, "contact origins_m"),
    ],
)
def test_what_is_no_contact_is_refused(arguments, message):
    good = {"points_m": np.zeros((1, 3)), "normals": UP, "force_n": np.ones(1)}
    with pytest.raises(ValueError, match=message):
        Contacts(**(good | arguments))
