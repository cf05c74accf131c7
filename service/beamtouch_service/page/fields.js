// The figures that the page shows. `make reference` writes this file from the tables of fields.

/** The large figures, by the number of axes of a surface. */
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

/** The columns of an event, on surfaces of any number of axes. */
export const COLUMNS = [
  {
    "name": "touched_at",
    "label": "Began at",
    "unit": ""
  },
  {
    "name": "place",
    "label": "Mean at",
    "unit": "mm"
  },
  {
    "name": "mean_force_n",
    "label": "Mean force",
    "unit": "N"
  },
  {
    "name": "dwell_ms",
    "label": "For",
    "unit": "s"
  }
];
