# SPDX-License-Identifier: Apache-2.0
"""Files of the catalogue of public datasets, one a family; `slamhive.model.catalogue` reads them."""
