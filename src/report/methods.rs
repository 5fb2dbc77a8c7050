//! How every figure came about, for page, document and `report.json`.

/// Name and text of each method.
pub(super) const METHODS: [(&str, &str); 14] = [
    (
        "Distances",
        "Each outline is walked in steps of 0.05 mm and the exact distance to the other one is taken, both ways, pooled. Sampling errs by less than 0.001 mm on the mean; the maximum may miss a corner by 0.025 mm.",
    ),
    (
        "Boundary in the image",
        "Half-way between the grey levels inside and outside, along the normal of the contour, linear between pixels, averaged over about a pixel along the contour; found from the grey values alone. Behind a wall hardly thicker than the blur, the wall's own level is found from all profiles of the contour together. Blur draws the half-way point of a curved boundary inward by s\u{b2}k/2; this is measured (blur s from the steepness of the edge, curvature k from the contour) and undone. Where no clear edge exists, the place is left out.",
    ),
    (
        "Uncertainty",
        "Standard uncertainties. Of a figure of a step: half of what it differs between every second sample and the others; chords (0.001 mm) and round ends of beads (0.002 mm), which all places have in common, in full; what a place of the boundary in the image scatters (noise, pixels), or a voxel of a scan, in full for the 95th percentile and the maximum, over the root of the number of planes for the others. Dice and area: the same length along the outlines, over the areas. What all planes of an image have in common (the half-way level, the model of its blur) is in none of them.",
    ),
    (
        "Beads",
        "Strokes of their width with round joints and ends, united per layer. The lumen of a hollow wall is what the beads enclose and leave open; that of a cast is what they cover, with the pores between them.",
    ),
    (
        "Registration",
        "Image, solid and job stay where the job was planned; nothing is fitted to the recorded material. The planned outlines at the CT planes were checked to lie within 0.01 mm of the layers' outlines, corner by corner. Recorded pieces belong to the layer at whose height they were deposited. Where no record was kept, the lines that the printer has acknowledged stand in its place: what it was told, not what it did. A scan of the replica alone has no place of its own and is laid over the model by a fit (below).",
    ),
    (
        "Areas and Dice",
        "Boolean operations on polygons on a grid of 10 nm. Dice is twice the common area over the sum of both areas; IoU the common over the united area; both are 1 for identical areas.",
    ),
    (
        "Diameters and stenosis",
        "In the CT plane. Equivalent: of the circle of the same area. Minimum: least distance between parallel lines that enclose the lumen. NASCET: 1 - narrowest / first normal segment beyond (5 mm or more, within 5 % of its mean), minimum diameters.",
    ),
    (
        "Defects",
        "Recorded beads are laid over the planned ones of their layer (lengths and moments; where these differ, a robust fit of shift, turn and scale), outlines over those of the stage before (offset and shift, robust; one similarity of all planes first). Stretches of an outline (1 mm, two pixels) that lie off alone, and diameters of equal area, are told besides. Series over layers and planes are cut where they jump. Sizes carry a standard uncertainty. Nothing of it changes the figures.",
    ),
    (
        "Largest diameter",
        "Largest distance of two points of the lumen in the CT plane; exact on the outline's polygon.",
    ),
    (
        "Centreline and tortuosity",
        "Through the centroids in the CT planes, by cubics with the slopes of the polynomial through five planes; length by Gauss's rule. Tortuosity is length over chord minus one.",
    ),
    (
        "Divisions",
        "Height at which the section of the solid falls apart, by bisection to 0.001 mm; place: the middle between the nearest points of both pieces. Angles between the straight lines that fit the first 10 mm of each centreline best.",
    ),
    (
        "Wall",
        "From places 0.1 mm apart along the lumen the exact distance to the outline of the whole part, in the plane: more than the thickness in space where the wall stands obliquely. Filled: material over all between the outlines.",
    ),
    (
        "Scan of the replica",
        "Where one was given. The bright body of the model's volume, its surface half-way between air and material (levels and blur from profiles across the outer skin), laid over the model by a rigid fit along the normals, weighted by Tukey's function: principal axes with every sign and turns about them as starts; the mirror image is tried only to be told. The scan is read at the CT planes (trilinear); what blur draws inward is undone as for the image. Scale is measured and not taken away. Between the planes, too, the material of the scan is laid over the model's: pieces that reach farther into wall, lumen or outside than an outline may lie off are measured and joined from height to height; of strands and edges hardly thicker than the blur less is seen than there is. The ends are read along upright lines in the middle of the wall. Voxels larger than half the wall (of a cast: a quarter of its least width) judge nothing. No other stage rests on it.",
    ),
    (
        "Volumes",
        "Lumen: areas in the CT planes integrated by cubics; its uncertainty is half of what leaving out every second plane changes. Layers: area times height. Material: cross-section of the beads times length; recorded: the record's own volumes.",
    ),
];
