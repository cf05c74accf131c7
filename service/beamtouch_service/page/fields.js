// The large figures, by the number of axes of a surface. `make reference` writes this file from the table of fields.

export const FIGURES = {
  "1": [
    {
      "id": "position",
      "name": "position_mm",
      "ends": [
        "position_low_mm",
        "position_high_mm"
      ],
      "axis": 0,
      "label": "Position",
      "unit": "mm"
    },
    {
      "id": "force",
      "name": "force_n",
      "ends": [
        "force_low_n",
        "force_high_n"
      ],
      "axis": null,
      "label": "Force",
      "unit": "N"
    },
    {
      "id": "age",
      "name": "age_ms",
      "ends": null,
      "axis": null,
      "label": "Age",
      "unit": "ms"
    }
  ],
  "2": [
    {
      "id": "x",
      "name": "x_mm",
      "ends": [
        "x_low_mm",
        "x_high_mm"
      ],
      "axis": 0,
      "label": "x",
      "unit": "mm"
    },
    {
      "id": "y",
      "name": "y_mm",
      "ends": [
        "y_low_mm",
        "y_high_mm"
      ],
      "axis": 1,
      "label": "y",
      "unit": "mm"
    },
    {
      "id": "force",
      "name": "force_n",
      "ends": [
        "force_low_n",
        "force_high_n"
      ],
      "axis": null,
      "label": "Force",
      "unit": "N"
    },
    {
      "id": "age",
      "name": "age_ms",
      "ends": null,
      "axis": null,
      "label": "Age",
      "unit": "ms"
    }
  ]
};
